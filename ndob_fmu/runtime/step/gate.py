"""The innovation gate: which samples are used, judged by how far they lie from their prediction.

A sample is rejected where its innovation e = y − C ξ̂⁻ exceeds the sum of three parts: six standard deviations, twice
the largest steady response to the class of disturbances, and the response to a jump of d by 2 D₀ since the sample
before. After ten rejections in a row the estimate must be wrong, not the samples: the observer starts anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.step_designs import StepDesign

MOST_REJECTIONS = 10
_GATE = 6.0


@dataclass(frozen=True)
class Verdict:
    """What the gate decides about a sample.

    used: whether the sample corrects the estimate.
    restart: whether the covariance starts anew before that.
    rejected: samples rejected in a row, this one included.
    innovation (p,): that of the sample, or the largest plausible one where it was rejected or not finite.
    """

    used: bool
    restart: bool
    rejected: int
    innovation: Array


def accepted_unjudged(innovation: Array, *, finite: bool) -> Verdict:
    """Return the verdict during the start-up.

    There the covariance does not cover the error of f yet, so that no sample can be called implausible.
    """
    return Verdict(used=finite, restart=False, rejected=0, innovation=innovation)


def judge(
    innovation: Array, last: Array, rejected: int, S_factor: Array, design: StepDesign, *, finite: bool
) -> Verdict:
    """Judge a sample by its innovation (p,).

    last (p,): magnitude of the innovation before
    rejected: samples rejected in a row before this one
    S_factor (p,p): factor of the innovation's covariance
    finite: whether the sample is
    """
    if finite and np.all(np.abs(innovation) <= gate(S_factor, design)):
        return Verdict(used=True, restart=False, rejected=0, innovation=innovation)
    plausible = jump_gate(last, S_factor, design)
    if not finite:
        return Verdict(used=False, restart=False, rejected=0, innovation=plausible)
    if np.all(np.abs(innovation) <= plausible):
        return Verdict(used=True, restart=False, rejected=0, innovation=innovation)
    if rejected < MOST_REJECTIONS:
        return Verdict(used=False, restart=False, rejected=rejected + 1, innovation=plausible)
    return Verdict(used=True, restart=True, rejected=0, innovation=plausible)


def gate(S_factor: Array, design: StepDesign) -> Array:
    """Return the largest innovation (p,) that noise and the class of disturbances explain without any jump."""
    noise = np.linalg.norm(S_factor, axis=1) / design.stationary.intensities.scale
    return np.asarray(_GATE * noise + design.steady_innovation)


def jump_gate(last: Array, S_factor: Array, design: StepDesign) -> Array:
    """Return the largest innovation (p,) that a jump of d by at most 2 D₀ explains besides; last as in `judge`.

    A jump shows in sample after sample, and more in each until the observer catches up. A jump j samples ago was at
    most as large as the last innovation allows, and the noise may have hidden part of that.
    """
    without_jump = gate(S_factor, design)
    responses, largest = design.stationary.jump_responses, 2.0 * design.known.disturbance_bound
    with np.errstate(divide="ignore"):
        allowed = np.min((last + without_jump)[:, None] / responses[:, :-1], axis=2)
    jumps = np.minimum(allowed, largest)
    now = np.einsum("ijpq,ijq->ijpq", responses[:, 1:], jumps)
    return np.asarray(without_jump + np.max(now, axis=(0, 1)).sum(axis=1))
