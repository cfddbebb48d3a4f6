"""What a sample changes in the memory of its output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log, pi, sqrt

from ndob_fmu.runtime.generated_steps import MEMORY
from ndob_fmu.runtime.step.adaptive_noise import averaged, common_step, of_rounding, weight_of
from ndob_fmu.runtime.step.faulty_samples import SUSPICIOUS
from ndob_fmu.runtime.step.filter_state import SensorMemory

# What a refused sample adds at most to an output's debt, and what a used one leaves of it.
_MOST_DEBT = 10.0
_DEBT_LEFT = 0.5
# They make the noise smaller than it was told only where it makes more than this part: a disturbance that is calmer
# than its bounds makes innovations small too.
MOST = 0.5
# Normalised innovations are averaged over so many samples. What exceeds their mean tells of the noise, the mean of the
# model.
_LATEST = 10.0
_LIMIT = 4.0
# The share of outliers is that of about so many samples. A refused sample becomes one little by little, within about so
# many used samples that show no jump.
_OUTLIER_MEMORY, _DOUBT = 300.0, 10.0
# An innovation follows the one before that is not smaller by more than this factor. What a refused sample left counts
# as one before up to so many standard deviations. Innovations that are too large on average are too large as a rule.
_FOLLOWS, _NEAR, _RULE = 2.5, 10.0, 2.0
# A sensor breaks where its sample is further from the prediction than so many standard deviations, and so many times as
# far as the prediction is from the sample before: no equation that is somewhat wrong does that in one step.
_FAR, _AWAY = 10.0, 5.0
# A jump of the disturbance that explains the samples has shown before they are so improbable, in nats.
SETTLED = 40.0
# It is broken while each sample is within so many standard deviations of the noise from the one before, and it has not
# moved by the second number of them as its prediction has, to this part of that.
_NEAR_BEFORE, _MOVED, _ALONG = 4.0, 6.0, 0.5
# A change of at most so many standard deviations of the noise would be none if the sensor were rounded. The noise shows
# where the innovation changes by the second number of them. So many such changes are counted.
_SMALL, _NOISE, _FINE = 2.0, 0.5, 100.0
LATE = 1.5  # the estimate counts as valid for so many of the usual intervals between samples


def latest_mean(sensor: SensorMemory, e: float, alpha: float) -> float:
    """Return the mean of the latest innovations, over their standard deviations, with e of variance α."""
    normalised = min(max(e / sqrt(alpha), -_LIMIT), _LIMIT)
    return sensor.mean + (normalised - sensor.mean) / _LATEST


def goes_on(sensor: SensorMemory, e: float, alpha: float) -> bool:
    """Return whether an innovation e of variance α goes on as those before, as a wrong model makes them.

    Faults come suddenly. What grows on one side, or was large all the time, is the model's error.
    """
    before = sensor.last * max(1.0, sqrt(alpha / sensor.last_variance))
    follows = before * e > 0.0 and abs(e) <= _FOLLOWS * abs(before)
    return follows or (sensor.usual > _RULE and e * e <= SUSPICIOUS**2 * sensor.usual * alpha)


def in_a_row(sensor: SensorMemory, noise: float) -> float:
    """Return the logarithm of the probability that a good sensor repeats its sample once more, after those in a row.

    Noise that shows in small changes repeats no value but by the rounding, whose step is known to be no larger than
    the common one of all changes.

    noise: its variance
    """
    of_rounding_alike = min(sensor.resolution / sqrt(2.0 * pi * noise), 1.0)
    return sensor.in_a_row + log(max(sensor.repeat_rate, 1.0 / (1.0 + sensor.fine), of_rounding_alike))


def _jumps_away(sample: Innovation) -> bool:
    """Return whether a sensor breaks: it jumps where neither the plant's motion nor a wrong equation explains it."""
    e = sample.e
    return e * e > _FAR**2 * sample.alpha and abs(e) > _AWAY * abs(sample.change - e)


def is_still_broken(sensor: SensorMemory, value: float, change: float, e: float, noise: float) -> bool:
    """Return whether a sensor that broke stands still, with a sample of a value that changed, and its innovation e.

    One that moves as predicted is not broken: it, or the plant, was moved by hand.

    noise: its variance
    """
    moved, predicted = value - sensor.broke_at, value - e - sensor.expected
    along = abs(moved) > _MOVED * sqrt(noise) and abs(moved - predicted) < _ALONG * abs(moved)
    return sensor.broken and abs(change) <= _NEAR_BEFORE * sqrt(2.0 * noise) and not along


def _shows_noise(sensor: SensorMemory, sample: Innovation) -> bool:
    """Return whether a change would have been none with a rounded sensor, and shows noise.

    Without noise the innovation changes little by little.
    """
    size = sqrt(sample.noise)
    return abs(sample.change) <= _SMALL * size and abs(sample.e - sensor.last) >= _NOISE * size


def _repeat_rate(sensor: SensorMemory, repeats: bool) -> float:
    """Return the share of repeated samples with one more; after a refused sample the next one does not count."""
    return sensor.repeat_rate if sensor.refused else sensor.repeat_rate + (repeats - sensor.repeat_rate) / MEMORY


@dataclass(slots=True)
class Innovation:
    """What a sample tells of the noise of its output.

    e, alpha: the innovation and its variance
    noise, told: the variance of the noise, as the filter has it and as it was told
    mean: as `latest_mean`
    value: of the sample
    change: from the sample before, NaN for the first one
    repeats: whether the sample repeats the one before
    learns: whether the start is over
    """

    e: float
    alpha: float
    noise: float
    told: float
    mean: float
    value: float
    change: float
    repeats: bool
    learns: bool


def _common_step(sensor: SensorMemory, sample: Innovation, repeat_rate: float) -> tuple[float, float]:
    """Return the step of the samples' changes, and how many told it, as in the memory, after a sample."""
    return common_step(sensor.resolution, sensor.multiples, abs(sample.change), repeats=repeat_rate > 0.0)


def after_used(sensor: SensorMemory, sample: Innovation, residual: float) -> SensorMemory:
    """Return the memory after a sample that was used, and left a residual."""
    repeat_rate = _repeat_rate(sensor, sample.repeats)
    resolution, multiples = _common_step(sensor, sample, repeat_rate)
    ratio, counted = _followed(sensor, sample, residual, of_rounding(resolution, multiples, repeat_rate))
    found = sensor.doubtful / _DOUBT
    return SensorMemory(
        noise_ratio=ratio,
        counted=counted,
        repeat_rate=repeat_rate,
        outlier_rate=sensor.outlier_rate + (found - sensor.outlier_rate) / _OUTLIER_MEMORY,
        doubtful=sensor.doubtful - found,
        resolution=resolution,
        multiples=multiples,
        fine=0.5 * sensor.fine if sample.repeats else min(sensor.fine + _shows_noise(sensor, sample), _FINE),
        in_a_row=in_a_row(sensor, sample.noise) if sample.repeats else 0.0,
        broken=False,
        broke_at=0.0,
        expected=0.0,
        refused=False,
        debt=sensor.debt * _DEBT_LEFT,
        skipped=sensor.skipped,
        drift=sensor.drift,
        mean=sample.mean,
        last=sample.e,
        last_variance=sample.alpha,
        usual=sensor.usual + (sample.e**2 / sample.alpha - sensor.usual) / _LATEST,
        waited=0.0,
        interval=max(sensor.waited, sensor.interval * (1.0 - 0.5 / MEMORY)),
    )


def after_refused(
    sensor: SensorMemory, sample: Innovation, if_faulty: float, *, stuck: bool, broken: bool
) -> SensorMemory:
    """Return the memory after a sample that was refused.

    if_faulty: logarithm of its probability
    stuck: whether a sensor of this sample is stuck
    broken: whether this one is broken, as `is_still_broken`
    """
    e, fresh = sample.e, sensor.debt == 0.0
    debt = sensor.debt + (0.0 if sample.repeats else min(max(-if_faulty, 0.0), _MOST_DEBT))
    breaks = sample.learns and not broken and not sample.repeats and _jumps_away(sample)
    near = sample.e**2 <= _NEAR**2 * sample.alpha
    repeat_rate = _repeat_rate(sensor, sample.repeats)
    resolution, multiples = _common_step(sensor, sample, repeat_rate)
    rounding = of_rounding(resolution, multiples, repeat_rate)
    ratio, counted = _followed(sensor, sample, e, rounding)
    if stuck or broken:
        ratio = max(sensor.noise_ratio, rounding / sample.told) if sample.learns else sensor.noise_ratio
    return SensorMemory(
        noise_ratio=ratio,
        counted=counted,
        repeat_rate=repeat_rate,
        outlier_rate=sensor.outlier_rate,
        doubtful=sensor.doubtful + (not (sample.repeats or broken)),
        resolution=resolution,
        multiples=multiples,
        fine=sensor.fine,
        in_a_row=sensor.in_a_row if sample.repeats else 0.0,
        broken=breaks or broken,
        broke_at=sample.value if breaks else sensor.broke_at,
        expected=sample.value - e if breaks else sensor.expected,
        refused=True,
        debt=min(debt, SETTLED) if broken else debt,
        skipped=e * e if fresh else 0.5 * (sensor.skipped + e * e),
        drift=e if fresh else 0.5 * (sensor.drift + e),
        mean=sample.mean,
        last=sample.e if near else sensor.last,
        last_variance=sample.alpha if near else sensor.last_variance,
        usual=sensor.usual,
        waited=sensor.waited,
        interval=sensor.interval,
    )


def _followed(sensor: SensorMemory, sample: Innovation, residual: float, rounding: float) -> tuple[float, float]:
    """Return the ratio of the noise, and the samples behind it, after an innovation and the residual that it leaves.

    rounding: the least variance of the noise
    """
    if not sample.learns:
        return sensor.noise_ratio, sensor.counted
    weight, told = weight_of(sample.noise, sample.alpha), sample.told
    product = (sample.e - sensor.mean * sqrt(sample.alpha)) * residual
    counted = sensor.counted + weight
    ratio = averaged(sensor.noise_ratio, counted, product / told, sample.alpha / told, weight)
    if sample.noise < MOST * sample.alpha:
        ratio = max(ratio, min(sensor.noise_ratio, 1.0))
    return max(ratio, rounding / told), counted


def after_jump(sensor: SensorMemory, *, used: bool) -> SensorMemory:
    """Return the memory once a jump is certain: what looked like an outlier was the jump, whose size it has told.

    used: whether the sample was
    """
    broken, waited = sensor.broken and not used, 0.0 if used else sensor.waited
    debt = sensor.debt if broken else 0.0
    return replace(sensor, mean=0.0, debt=debt, doubtful=0.0, refused=False, broken=broken, waited=waited)


def at_end_of_step(sensor: SensorMemory, H: float) -> SensorMemory:
    """Return the memory a step H (s) later; before two samples the interval counts as one step."""
    return SensorMemory(
        noise_ratio=sensor.noise_ratio,
        counted=sensor.counted,
        repeat_rate=sensor.repeat_rate,
        outlier_rate=sensor.outlier_rate,
        doubtful=sensor.doubtful,
        resolution=sensor.resolution,
        multiples=sensor.multiples,
        fine=sensor.fine,
        in_a_row=sensor.in_a_row,
        broken=sensor.broken,
        broke_at=sensor.broke_at,
        expected=sensor.expected,
        refused=sensor.refused,
        debt=sensor.debt,
        skipped=sensor.skipped,
        drift=sensor.drift,
        mean=sensor.mean,
        last=sensor.last,
        last_variance=sensor.last_variance,
        usual=sensor.usual,
        waited=sensor.waited + H,
        interval=sensor.interval if sensor.interval > 0.0 else H,
    )


def is_in_time(sensors: Sequence[SensorMemory]) -> bool:
    """Return whether a sample was used within the usual interval of the slowest sensor, or not much longer ago."""
    waited = min(sensor.waited for sensor in sensors)
    return waited <= LATE * max(sensor.interval for sensor in sensors)
