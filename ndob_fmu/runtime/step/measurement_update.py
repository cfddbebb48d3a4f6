"""The measurement update: ξ̂ = ξ̂⁻ + K e with the innovation e = y − C ξ̂⁻, where the gate lets the sample through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.start_up import StartUp
from ndob_fmu.runtime.design.stationary_design import StationaryDesign
from ndob_fmu.runtime.design.step_designs import StepDesign
from ndob_fmu.runtime.numerics.kalman import Update, gain_change, update
from ndob_fmu.runtime.step.gate import accepted_unjudged, judge
from ndob_fmu.runtime.step.sampled_observer_state import SampledObserverState

_CONVERGED = 1e-7  # largest change of a correction K e, in standard deviations of the state that it corrects


@dataclass(frozen=True)
class Sample:
    """A sample against its prediction.

    innovation (p,): y − C ξ̂⁻; 0 where the sample is not finite.
    finite: whether the sample is.
    """

    innovation: Array
    finite: bool


@dataclass(frozen=True)
class Corrected:
    """The estimate at a sample, after it was used or left out.

    xi_hat (N,) and d_hat (q2,): ξ̂ and d̂.
    factor (N,N): of the covariance of ξ̂.
    used: whether the sample was; otherwise the step coasts.
    valid: whether the estimate is shown as valid.
    converged: whether the gain is frozen from now on.
    innovation (p,): as in `Verdict`.
    rejected: as in `Verdict`.
    age: samples since the start, before this one.
    next_age: the same, this one included.
    """

    xi_hat: Array
    d_hat: Array
    factor: Array
    used: bool
    valid: bool
    converged: bool
    innovation: Array
    rejected: int
    age: int
    next_age: int


def correct(
    state: SampledObserverState, xi_hat: Array, sample: Sample, design: StepDesign, start: StartUp, H: float
) -> Corrected:
    """Correct ξ̂⁻ (N,) of a state with a sample at the start of a step H (s)."""
    before, stationary = state.covariance, design.stationary
    C = stationary.system.C
    measured = stationary.update if before.converged else update(before.factor, C, stationary.sample_factor)
    if before.converged or before.rejected:
        last = np.abs(state.innovation)
        S_factor = measured.innovation_factor
        verdict = judge(sample.innovation, last, before.rejected, S_factor, design, finite=sample.finite)
    else:
        verdict = accepted_unjudged(sample.innovation, finite=sample.finite)
    age = before.age
    if verdict.restart:
        measured, age = update(start.factor, C, stationary.sample_factor), 0
    factor, d_hat = before.factor, np.array(state.d_hat)
    if verdict.used:
        xi_hat, factor = xi_hat + measured.K @ sample.innovation, measured.factor
        d_hat = _disturbance(xi_hat, sample.innovation, measured, stationary)
    may_converge = verdict.used and age >= start.samples and design.H == H
    return Corrected(
        xi_hat=xi_hat,
        d_hat=d_hat,
        factor=factor,
        used=verdict.used,
        valid=verdict.used,
        converged=may_converge and (before.converged or gain_change(measured, stationary.update) <= _CONVERGED),
        innovation=verdict.innovation,
        rejected=verdict.rejected,
        age=age,
        next_age=min(age + 1, start.samples),
    )


def leave_out(state: SampledObserverState, xi_hat: Array, sample: Sample) -> Corrected:
    """Keep ξ̂⁻ (N,) of a state as it is before a short step, whose sample is not used."""
    before = state.covariance
    return Corrected(
        xi_hat=xi_hat,
        d_hat=np.array(state.d_hat),
        factor=before.factor,
        used=False,
        valid=sample.finite and before.rejected == 0,
        converged=False,
        innovation=np.array(state.innovation),
        rejected=before.rejected,
        age=before.age,
        next_age=before.age,
    )


def _disturbance(xi_hat: Array, innovation: Array, measured: Update, stationary: StationaryDesign) -> Array:
    """Return d̂ (q2,) after an update.

    For r = 0 it is M_H S_∞ S⁻¹ e: an innovation counts by its covariance S against that of the converged filter.
    """
    if stationary.M_H is None:
        n, q = stationary.system.linear.G_d.shape
        return xi_hat[n : n + q]
    if measured is stationary.update:
        return np.asarray(stationary.M_H @ innovation)
    S_factor = measured.innovation_factor
    weighted = np.linalg.solve(S_factor.T, np.linalg.solve(S_factor, innovation))
    S_converged = stationary.update.innovation_factor @ stationary.update.innovation_factor.T
    return np.asarray(stationary.M_H @ S_converged @ weighted)
