"""Rounding of computed numbers to the digits that are the same on every processor."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array

_DIGITS = 9
# An entry below this share of the largest one is taken to be the rounding error of a zero.
_ZERO = 1e-13


def certain_digits(values: Array) -> Array:
    """Return an array (any shape) with each entry rounded to 9 significant digits, and rounding errors of zeros to 0.

    The last digits depend on the processor's kernels of linear algebra. A file or message with them would differ
    between processors.
    """
    largest = float(np.max(np.abs(values), initial=0.0))
    rounded = [0.0 if abs(value) <= _ZERO * largest else float(f"{value:.{_DIGITS}g}") for value in values.flat]
    return np.array(rounded).reshape(values.shape)
