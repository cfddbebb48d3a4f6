"""What comes rarely and is large, as a pulse among the rows of a log: by which weight, and in which rows, it counts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array

# Standard deviations beyond which a number is rare.
_FAR = 2.5
# Nearly the least absolute deviations: numbers beyond this part of a standard deviation count by their size, not by its
# square. They are found in so many rounds, at most; a round that changes the standard deviation by less is the last.
_NEAR, _ROUNDS, _SAME = 0.05, 50, 0.01
# A normal number is as often within the median of its size as beyond it, and that is its standard deviation over this.
_STD_OF_MEDIAN = 1.4826


def usual_std(numbers: Array) -> Array:
    """Return the standard deviations (…) of columns (K,…) about 0, by the median, which rare numbers leave as it is."""
    return np.asarray(_STD_OF_MEDIAN * np.median(np.abs(numbers), axis=0))


def weights_of_usual(left: Callable[[Array], Array], rows: int) -> Array:
    """Return 1 for what is usual and 0 for what is rare among the numbers left(weights) (K,…) of least squares.

    Weights begin with one for each of so many rows, and have the shape of these numbers then. The standard deviation
    is that about the least absolute deviations, because the least squares may spread a pulse over all rows. Huber's
    weights tell then what is rare.
    """
    found: Array = np.ones(rows)
    std: Array = np.array(np.inf)
    for _ in range(_ROUNDS):
        numbers, before = left(found), std
        std = usual_std(numbers)
        found = _huber(numbers, _NEAR * std)
        if np.all(np.abs(std - before) <= _SAME * std):
            break
    for _ in range(_ROUNDS):
        before, found = found, _huber(left(found), _FAR * std)
        if np.all(np.abs(found - before) <= _SAME):
            break
    return np.asarray(found == 1.0, dtype=float)


def _huber(numbers: Array, far: Array) -> Array:
    return np.asarray(np.minimum(1.0, far / np.maximum(np.abs(numbers), 1e-300)))


def are_usual(numbers: Array) -> NDArray[np.bool_]:
    """Return which numbers (K,…) are not rare."""
    return np.asarray(np.abs(numbers) <= _FAR * usual_std(numbers))
