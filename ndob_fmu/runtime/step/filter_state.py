"""What the sampled-data observer remembers from one step to the next."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.generated_steps import Numbers
from ndob_fmu.runtime.step.error_columns import ErrorColumns
from ndob_fmu.runtime.step.faulty_samples import FIRST_RATE


@dataclass(slots=True)  # never changed once made; frozen=True would make that cost a hundredth of a step
class JumpBank:
    """Hypotheses that a disturbance jumped in one of the last steps: at its sample, and inside the step.

    What jumps of one have added to the error of ξ̂ until now is in `ErrorColumns`.

    sizes (2 L q2,3,4): factor of the covariance of the jumps' sizes, and beside it these sizes, as the innovations
        since tell them.
    misfit (3,2 L q2): sums of squared innovations since, over their variances, without and with the hypothesis, and
        their number.
    log_weight (2 L q2,): logarithm of the weight over that of no jump but for the misfit; −∞ for an empty place.
    newest_age: time since the last hypotheses were added (s).
    since_jump: samples since a jump was certain, counted up to a limit.
    rate: share of samples with a jump until now.
    """

    sizes: Array
    misfit: Array
    log_weight: Array
    newest_age: float
    since_jump: int
    rate: float


@dataclass(slots=True)  # as above
class SensorMemory:
    """What is remembered of one output's samples.

    noise_ratio: the variance of the noise over the one that was told.
    counted: samples behind `noise_ratio`.
    repeat_rate: share of samples that repeated the one before.
    outlier_rate: share of samples that were outliers.
    doubtful: refused samples that are not in `outlier_rate` yet, because a jump may still explain them.
    resolution: the step of which all changes from one sample to the next may be multiples; ∞ before there was one.
    multiples: how many changes told that they are, counted up to a limit.
    fine: changes from one sample to the next, of about the noise or less, in which noise showed; halved by each repeat
        that is used, counted up to a limit.
    in_a_row: logarithm of the probability that a good sensor repeats its sample as often as this one just did.
    broken: whether the sensor jumped away from its prediction and has stood still since.
    broke_at, expected: the sample with which it did, and its prediction.
    refused: whether the last sample was refused.
    debt: how improbable the refused samples are, in nats; falls with each sample that is used.
    skipped, drift: mean square and mean of the innovations that were refused.
    mean: of the latest innovations, each over its standard deviation.
    last, last_variance: the last innovation, but for those far away that were refused, and its variance, ∞
        before the first one.
    usual: mean square of the latest innovations that were used, each over its standard deviation.
    waited: time since the last sample that was used (s).
    interval: the longest usual time between two samples that are used (s).
    """

    noise_ratio: float = 1.0
    counted: float = 0.0
    repeat_rate: float = 0.0
    outlier_rate: float = FIRST_RATE
    doubtful: float = 0.0
    resolution: float = inf
    multiples: float = 0.0
    fine: float = 0.0
    in_a_row: float = 0.0
    broken: bool = False
    broke_at: float = 0.0
    expected: float = 0.0
    refused: bool = False
    debt: float = 0.0
    skipped: float = 0.0
    drift: float = 0.0
    mean: float = 0.0
    last: float = 0.0
    last_variance: float = inf
    usual: float = 1.0
    waited: float = 0.0
    interval: float = 0.0


@dataclass(frozen=True)
class LagMemory:
    """Disturbances of the past, smoothed by the samples since, K instants; empty without a lag.

    age (K,): how long ago each was (s); −1 for an empty place.
    value, variance (K q2,): the smoothed disturbance and its variance.
    signatures (K q2,4 L q2): what jumps of one have added to the error of each; no columns where nobody asks for jumps.
    """

    age: Array
    value: Array
    variance: Array
    signatures: Array


@dataclass(frozen=True)
class FilterMemory:
    """How well ξ̂⁻ is known, and all that decides about the next sample.

    columns: factor (N + past,N + past) of the covariance of ξ̂⁻ and of what delayed sensors measured, and what goes
        with it.
    past (past,): estimates of what delayed sensors measured; past_age (K,): how long ago (s), −1 for an empty place.
    jumps, lagged: as above; sensors (p,): of each output.
    age: samples since the start, counted until the start-up is over.
    lost: whether the estimate was given up and has not converged again.
    converged: whether the gain is frozen; frozen_noise (p,): for which factors on the variances of the samples.
    tuned_at: the step that the intensities are tuned for (s); 0 before the first step.
    step, steady: the last step, or the one that the frozen gain is for (s), and how many steps in a row had about its
        length and used all samples, counted until the start is over.
    model_error: the part of the terms of doubtful equations that counts as noise.
    """

    columns: ErrorColumns
    past: Array
    past_age: Array
    jumps: JumpBank
    sensors: tuple[SensorMemory, ...]
    lagged: LagMemory
    age: int
    lost: bool
    converged: bool
    frozen_noise: tuple[float, ...]
    tuned_at: float
    step: float
    steady: int
    model_error: float


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


@np.errstate(over="ignore", invalid="ignore")  # a sum that is not finite tells what it is here for
def is_possible(memory: FilterMemory) -> bool:
    """Return whether numbers in the form of a memory can be one."""
    jumps, lagged = memory.jumps, memory.lagged
    arrays = (
        memory.columns.values,
        memory.past,
        memory.past_age,
        lagged.age,
        lagged.value,
        lagged.variance,
        lagged.signatures,
        jumps.sizes,
        jumps.misfit,
    )
    return bool(
        all(_is_finite(each) for each in arrays)
        and jumps.misfit.min() >= 0.0
        and lagged.variance.min(initial=0.0) >= 0.0
        and jumps.log_weight.max() < inf
        and jumps.newest_age >= 0.0
        and 0.0 <= jumps.rate <= 1.0
        and all(map(_is_possible_sensor, memory.sensors))
        and all(0.0 < ratio < inf for ratio in memory.frozen_noise)
        and memory.tuned_at >= 0.0
        and memory.step >= 0.0
        and memory.age >= 0
        and memory.steady >= 0
        and 0.0 <= memory.model_error < inf
    )


def _is_finite(numbers: Array) -> bool:
    """Return whether numbers are finite and their sum is, too: one pass without another array."""
    return isfinite(float(numbers.sum()))


def _is_possible_sensor(sensor: SensorMemory) -> bool:
    return (
        0.0 <= sensor.noise_ratio < inf
        and 0.0 <= sensor.counted < inf
        and 0.0 <= sensor.multiples < inf
        and 0.0 <= sensor.fine < inf
        and -inf < sensor.in_a_row <= 0.0
        and 0.0 <= sensor.outlier_rate < inf
        and 0.0 <= sensor.doubtful < inf
        and 0.0 <= sensor.debt < inf
        and 0.0 <= sensor.usual < inf
        and 0.0 <= sensor.waited < inf
        and 0.0 <= sensor.interval < inf
        and isfinite(sensor.broke_at)
        and isfinite(sensor.expected)
        and isfinite(sensor.skipped)
        and isfinite(sensor.drift)
        and isfinite(sensor.mean)
        and isfinite(sensor.last)
        and sensor.resolution > 0.0
        and sensor.last_variance > 0.0
        and 0.0 <= sensor.repeat_rate <= 1.0
    )
