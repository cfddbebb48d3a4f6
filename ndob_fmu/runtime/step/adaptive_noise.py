"""The variance of each output's noise, followed from the innovations.

The product of the innovation e and of the residual after the update has the expectation R, whatever R the filter was
told (Mehra, 1970). The mean of the latest innovations is subtracted from e, because a wrong model makes it. The
product's moving average replaces the variance that was told where the two differ by a factor of two; so nothing is lost
where that was right.

Changes of rounded samples are multiples of one step, however fast the output moves. Euclid's algorithm finds it as
their greatest common divisor: the rest of a change that is no multiple takes its place. The rests of noise fall towards
zero. A rounding error has the variance of an equal distribution over the step. That is the least that the noise can be.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, isfinite, log2, remainder, sqrt

_MEMORY = 200.0
_FIRST, _SHOWN = 10.0, 50.0  # a noise that differs from what was told has shown by then
# Innovations tell of the noise where it makes more than this part of their variance.
_CLEAR = 6.0
LEAST_RATIO = 1e-4
_CREDIBLE = (0.5, 2.0)
# Samples are rounded where so many changes were multiples of the step, to this part of it. So many equal samples in a
# row at most count as one.
_SEEN, _EQUAL = 4.0, 1e-5
_LONGEST_ROW = 20.0


def averaged(ratio: float, counted: float, product: float, largest: float, weight: float) -> float:
    """Return the ratio of variances after one more product of innovation and residual, over the told variance."""
    limited = min(max(product, -9.0 * max(ratio, LEAST_RATIO)), 9.0 * largest)
    return ratio + weight * (limited - ratio) / min(_MEMORY, _FIRST + counted)


def common_step(step: float, multiples: float, change: float, *, repeats: bool) -> tuple[float, float]:
    """Return the step of which all changes may be multiples, and how many told that they are, after one more change.

    A change of one step tells nothing where each was of one: a plain motion has equal changes too. Samples that repeat
    are no plain motion.

    repeats: whether samples repeat now and then
    """
    if not change > 0.0:
        return step, multiples
    # The quotient overflows where the step is too small beside the change.
    if not isfinite(step) or not isfinite(change / step):
        return change, 0.0
    rest, times = abs(remainder(change, step)), float(round(change / step))
    if rest > _EQUAL * step or times == 0.0:
        return rest, 0.0
    # A change of many steps tells the step to more digits, which the next rests need.
    return change / times, min(multiples + (repeats or multiples > 0.0 or times > 1), _SEEN)


def of_rounding(step: float, multiples: float, repeat_rate: float) -> float:
    """Return the variance of the rounding of samples, 0 where they are not known to be rounded.

    The rounding error is the same while a sample repeats, so that all samples in a row tell as much as one.
    """
    width = step if multiples >= _SEEN else 0.0
    return width**2 / 12.0 / max(1.0 - repeat_rate, 1.0 / _LONGEST_ROW)


def in_use(ratios: Sequence[float], least: Sequence[float]) -> list[float]:
    """Return the ratios of variances (p,) that the filter uses, for the least possible ones (p,)."""
    return [
        1.0 if _CREDIBLE[0] < ratio < _CREDIBLE[1] else max(ratio, smallest)
        for ratio, smallest in zip(ratios, least, strict=True)
    ]


def weight_of(noise: float, alpha: float) -> float:
    """Return how much an innovation of variance α tells of the noise, whose variance is a part of it."""
    return min(1.0, (_CLEAR * noise / alpha) ** 2)


def is_settled(ratio: float, counted: float, weight: float) -> bool:
    """Return whether the ratio in use will stay, for one that was found.

    counted: the samples behind it, each with its weight; weight: of the last one
    """
    least, most = _CREDIBLE
    if not least < ratio < most:
        return _FIRST + counted >= _MEMORY
    # It stays as told where the one that was found is within the limits by two of its standard deviations.
    margin = 1.0 + 2.0 * sqrt(2.0 / (_FIRST + min(counted / weight, _MEMORY)))
    return counted >= _SHOWN * weight and least * margin < ratio < most / margin


def for_a_frozen_gain(used: Sequence[float], least: Sequence[float]) -> tuple[float, ...]:
    """Return the ratios of variances (p,) that a gain is frozen for: powers of 2^(1/4), so that there are few designs.

    used, least (p,): the ratios in use, and the least possible ones
    """
    return tuple(
        ratio if ratio <= smallest else 2.0 ** (0.25 * ceil(4.0 * log2(ratio)))
        for ratio, smallest in zip(used, least, strict=True)
    )
