"""What the sampled-data observer remembers from one step to the next."""

from __future__ import annotations

from dataclasses import dataclass

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.generated_steps import Numbers


@dataclass(frozen=True)
class JumpBank:
    """Hypotheses that a disturbance jumped in one of the last steps: at its sample, and inside the step.

    signatures (N + past,6 L q2): what jumps of one at up to three instants have added to the error of ξ̂ until now.
    evidence (2 L q2,3), precision (2 L q2,3,3): of their sizes, from the innovations since: Σ ρ e/α and Σ ρ ρᵀ/α.
    misfit (2 L q2,2): sum of e²/α since then, and the number of these innovations.
    log_weight (2 L q2,): logarithm of the weight without that evidence, over that of no jump; −∞ for an empty place.
    newest_age: time since the last hypotheses were added (s).
    since_jump: samples since a jump was certain, counted up to a limit.
    """

    signatures: Array
    evidence: Array
    precision: Array
    misfit: Array
    log_weight: Array
    newest_age: float
    since_jump: int


@dataclass(frozen=True)
class SensorMemory:
    """What is remembered of each output's samples, (p,).

    noise_ratio: the variance of the noise over the one that was told.
    counted: samples behind `noise_ratio`.
    repeat_rate: share of samples that repeated the one before.
    resolution: the smallest change from one sample to the next; ∞ before there was one.
    alike: how many changes were of that size, counted up to a limit.
    refused: whether the last sample was refused.
    debt: how improbable the refused samples are, in nats; falls with each sample that is used.
    skipped, drift: mean square and mean of the innovations that were refused.
    mean: of the latest innovations, each over its standard deviation.
    waited: time since the last sample that was used (s).
    interval: the longest usual time between two samples that are used (s).
    """

    noise_ratio: Array
    counted: Array
    repeat_rate: Array
    resolution: Array
    alike: Array
    refused: Array
    debt: Array
    skipped: Array
    drift: Array
    mean: Array
    waited: Array
    interval: Array


@dataclass(frozen=True)
class LagMemory:
    """Disturbances of the past, smoothed by the samples since: (K q2,) of K instants; empty without a lag.

    age (K,): how long ago each was (s); −1 for an empty place.
    value, variance (K q2,): the smoothed disturbance and its variance.
    covariance (N + past,K q2): its covariance with the error of ξ̂.
    """

    age: Array
    value: Array
    variance: Array
    covariance: Array


@dataclass(frozen=True)
class FilterMemory:
    """How well ξ̂⁻ is known, and all that decides about the next sample.

    factor (N + past,N + past): of the covariance of ξ̂⁻ and of what delayed sensors measured.
    past (past,): estimates of what delayed sensors measured; past_age (K,): how long ago (s), −1 for an empty place.
    jumps, sensors, lagged: as above.
    age: samples since the start, counted until the start-up is over.
    lost: whether the estimate was given up and has not converged again.
    converged: whether the gain is frozen.
    tuned_at: the step that the intensities are tuned for (s); 0 before the first step.
    step, steady: the last step (s), and how many steps in a row had its length, counted until the start is over.
    """

    factor: Array
    past: Array
    past_age: Array
    jumps: JumpBank
    sensors: SensorMemory
    lagged: LagMemory
    age: int
    lost: bool
    converged: bool
    tuned_at: float
    step: float
    steady: int


@dataclass(slots=True)  # never changed once made; frozen=True would make that cost a tenth of a step
class SampledObserverState:
    """All that the observer remembers, as of just before the next sample.

    xi_hat (N or more,): ξ̂⁻, with zeros for the derivatives of d̂ beyond the order r behind it.
    d_hat, d_std (q2,): what was published of d at the end of the last step.
    u (m,): the last finite input.
    innovation (p,): of the last sample.
    sample (p,): the last sample; NaN before the first one.
    squares (p,): moving averages of innovations squared over their variance.
    memory: the rest.
    """

    xi_hat: Numbers
    d_hat: Numbers
    d_std: Numbers
    u: Numbers
    innovation: Numbers
    sample: Numbers
    squares: Numbers
    memory: FilterMemory
