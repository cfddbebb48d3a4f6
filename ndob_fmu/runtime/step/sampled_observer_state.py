"""What the sampled-data observer remembers from one step to the next."""

from __future__ import annotations

from dataclasses import dataclass

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.generated_steps import Numbers


@dataclass(frozen=True)
class CovarianceState:
    """How well ξ̂⁻ is known, and what decides about the next gain.

    factor (N,N): of the covariance of ξ̂⁻.
    d_std (q2,): error bar of d̂.
    converged: whether the gain is frozen.
    tuned_at: the step (s) that the intensities were tuned for; 0 before the first step.
    waited: time (s) of the short steps since the last sample that was used.
    rejected: samples rejected in a row.
    age: samples since the start, counted until the start-up is over.
    """

    factor: Array
    d_std: Numbers
    converged: bool
    tuned_at: float
    waited: float
    rejected: int
    age: int


@dataclass(slots=True)  # never changed once made; frozen=True would make that cost a tenth of a step
class SampledObserverState:
    """All that the observer remembers, as of just before the next sample.

    xi_hat (n + 3 q2,): ξ̂⁻, and zeros for the derivatives of d̂ beyond the order r.
    d_hat (q2,): d̂.
    u (m,): the last finite input.
    innovation (p,): of the last sample, y − C ξ̂⁻; the largest plausible one where that sample was not used.
    covariance: how well ξ̂⁻ is known.
    """

    xi_hat: Numbers
    d_hat: Numbers
    u: Numbers
    innovation: Numbers
    covariance: CovarianceState
