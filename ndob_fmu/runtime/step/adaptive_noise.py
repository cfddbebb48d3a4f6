"""The variance of each output's noise, followed from the innovations.

The product of the innovation e and of the residual after the update has the expectation R, whatever R the filter was
told (Mehra, 1970). The mean of the latest innovations is subtracted from e, because a wrong model makes it. The
product's moving average replaces the variance that was told where the two differ by a factor of two; so nothing is lost
where that was right.

Noise makes all changes differ. Where the smallest change from one sample to the next comes again and again, it is the
step of a rounding, whose error has the variance of an equal distribution over it. That is the least that the noise can
be.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, log2

_MEMORY = 200.0
_FIRST = 10.0
LEAST_RATIO = 1e-4
_CREDIBLE = (0.5, 2.0)
# Samples are rounded where their smallest change was seen so many times, to this part. So many equal ones in a row at
# most count as one.
_SEEN, _EQUAL = 4.0, 1e-6
_LONGEST_ROW = 20.0


def averaged(ratio: float, counted: float, product: float, largest: float, weight: float) -> float:
    """Return the ratio of variances after one more product of innovation and residual, over the told variance."""
    limited = min(max(product, -9.0 * max(ratio, LEAST_RATIO)), 9.0 * largest)
    return ratio + weight * (limited - ratio) / min(_MEMORY, _FIRST + counted)


def smallest_change(resolution: float, alike: float, change: float) -> tuple[float, float]:
    """Return the smallest change from one sample to the next, and how often it was seen, after one more change."""
    if not change > 0.0:
        return resolution, alike
    least = min(resolution, change)
    if change > (1.0 + _EQUAL) * least:
        return least, alike
    return least, min(alike + 1.0, _SEEN) if resolution <= (1.0 + _EQUAL) * least else 1.0


def of_rounding(resolution: float, alike: float, repeat_rate: float) -> float:
    """Return the variance of the rounding of samples, 0 where they are not known to be rounded.

    The rounding error is the same while a sample repeats, so that all samples in a row tell as much as one.
    """
    width = resolution if alike >= _SEEN else 0.0
    return width**2 / 12.0 / max(1.0 - repeat_rate, 1.0 / _LONGEST_ROW)


def in_use(ratios: Sequence[float], least: Sequence[float]) -> list[float]:
    """Return the ratios of variances (p,) that the filter uses, for the least possible ones (p,)."""
    return [
        1.0 if _CREDIBLE[0] < ratio < _CREDIBLE[1] else max(ratio, smallest)
        for ratio, smallest in zip(ratios, least, strict=True)
    ]


def is_sure(counted: float) -> bool:
    """Return whether as many samples stand behind a ratio as it remembers."""
    return _FIRST + counted >= _MEMORY


def for_a_frozen_gain(used: Sequence[float], least: Sequence[float]) -> tuple[float, ...]:
    """Return the ratios of variances (p,) that a gain is frozen for: powers of 2^(1/4), so that there are few designs.

    used, least (p,): the ratios in use, and the least possible ones
    """
    return tuple(
        ratio if ratio <= smallest else 2.0 ** (0.25 * ceil(4.0 * log2(ratio)))
        for ratio, smallest in zip(used, least, strict=True)
    )
