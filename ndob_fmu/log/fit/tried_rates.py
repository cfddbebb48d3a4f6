"""The rate with which the observer follows a disturbance that jumps best: some are tried along the log.

How soon a jump is noticed, and how often one is seen where there is none, no likelihood tells: it knows all samples. So
the observer itself runs along rows of the log, and its estimate is compared with the smoothed one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array

TRIED = 4
# Rows along which they are tried, at most.
MOST_ROWS = 2000
# Error bars hold where so many errors are within two of them; else where as many are as with the highest rate.
_HOLD = 0.9


class Followed(NamedTuple):
    """What an observer says of the disturbances along rows of a log: d̂ (K,q2) at the samples, and its error bars."""

    d: Array
    std: Array


class _Tried(NamedTuple):
    rates: Array
    error: float
    hold: float


def best_followed(lowest: Array, highest: Array, follow: Callable[[Array], Followed], smoothed: Array) -> Array:
    """Return the rates (q2,) from the lowest to the highest with which the estimate errs least and its bars hold.

    follow: follow(rates) runs the observer along the rows of `smoothed` (K,q2)
    """
    shares = np.linspace(0.0, 1.0, TRIED)[:, None]
    tried = [_tried(rates, follow(rates), smoothed) for rates in lowest * (highest / lowest) ** shares]
    hold = min(_HOLD, tried[-1].hold)
    return min((one for one in tried if one.hold >= hold), key=lambda one: one.error).rates


def _tried(rates: Array, found: Followed, smoothed: Array) -> _Tried:
    error = np.abs(found.d - smoothed)
    of_sizes = error / np.maximum(np.max(np.abs(smoothed), axis=0), 1e-300)
    return _Tried(rates, float(np.mean(of_sizes**2)), float(np.mean(error <= 2.0 * found.std)))
