"""The variance of each output's noise, followed from the innovations.

The product of the innovation e and of the residual after the update has the expectation R, whatever R the filter was
told (Mehra, 1970). The mean of the latest innovations is subtracted from e, because a wrong model makes it. The
product's moving average replaces the variance that was told where the two differ by a factor of two; so nothing is lost
where that was right.
"""

from __future__ import annotations

from ndob_fmu.runtime.arrays import Array

_MEMORY = 200.0
_FIRST = 10.0
LEAST_RATIO = 1e-4
_CREDIBLE = (0.5, 2.0)


def averaged(ratio: float, counted: float, product: float, largest: float, weight: float) -> float:
    """Return the ratio of variances after one more product of innovation and residual, over the told variance."""
    limited = min(max(product, -9.0 * max(ratio, LEAST_RATIO)), 9.0 * largest)
    return ratio + weight * (limited - ratio) / min(_MEMORY, _FIRST + counted)


def in_use(ratios: Array, least: Array) -> list[float]:
    """Return the ratios of variances (p,) that the filter uses, for the least possible ones (p,)."""
    return [
        1.0 if _CREDIBLE[0] < ratio < _CREDIBLE[1] else max(ratio, smallest)
        for ratio, smallest in zip(ratios.tolist(), least.tolist(), strict=True)
    ]
