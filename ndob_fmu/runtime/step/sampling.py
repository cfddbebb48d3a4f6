"""Which samples the sampled-data observer uses, and for which step it is designed, where the host's steps vary.

A design belongs to one step. A step that is shorter and comes once (the last one before a stop time, the one before
an event) gets no design of its own: the estimate is predicted over it, and the sample at its start counts for nothing,
since the next one is as good. Once such steps together are as long as the step of the design, the observer uses the
sample again, and is designed anew for the shorter step.
"""

from __future__ import annotations

from dataclasses import dataclass

# The intensities stay as they are where the step differs by no more than this from the one they were tuned for.
_SIMILAR = 0.1
# The intensities are not tuned for a step below this part of the one before: between such samples the plant moves by
# less than they are rounded to. This is also the least part of the default experiment's step for the first one.
_SHORTEST = 1e-3


@dataclass(frozen=True)
class Sampling:
    """What one step does with the sample at its start.

    tuned_at: the step (s) that the intensities are tuned for
    designed_for: the step (s) of the gain
    used: whether the sample is used
    waited: time (s) since the last sample that was used, made up of short steps; 0 where this one is
    """

    tuned_at: float
    designed_for: float
    used: bool
    waited: float


def sampling(H: float, tuned_at: float, waited: float, usual_step: float) -> Sampling:
    """Return what a step H (s) does after short steps that lasted `waited` (s).

    tuned_at: the step (s) that the intensities are tuned for; 0 before the first step, which is compared with
    `usual_step` (s), that of the default experiment.
    """
    if tuned_at == 0.0:
        tuned_at = usual_step if _SHORTEST * usual_step > H else H
    if is_similar(H, tuned_at):
        return Sampling(tuned_at=tuned_at, designed_for=H, used=True, waited=0.0)
    waited += H
    if waited < (1.0 - _SIMILAR) * tuned_at:
        return Sampling(tuned_at=tuned_at, designed_for=tuned_at, used=False, waited=waited)
    if _SHORTEST * tuned_at > H:
        return Sampling(tuned_at=tuned_at, designed_for=tuned_at, used=True, waited=0.0)
    return Sampling(tuned_at=H, designed_for=H, used=True, waited=0.0)


def is_similar(H: float, tuned_at: float) -> bool:
    """Return whether intensities tuned for a step `tuned_at` (s) serve a step H (s) too."""
    return abs(H - tuned_at) <= _SIMILAR * tuned_at
