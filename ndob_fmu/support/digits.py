"""Numbers that were computed, and are written down, to the digits that are the same on every processor."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array

_DIGITS = 9
# An entry that is smaller than this part of the largest one is what rounding leaves of a zero.
_ZERO = 1e-13


def certain_digits(values: Array) -> Array:
    """Return an array (any shape) with each entry rounded to 9 significant digits, and rounding errors of zeros to 0.

    Kernels of linear algebra differ between processors and leave other last digits; a text or file that shows them
    would differ too.
    """
    largest = float(np.max(np.abs(values), initial=0.0))
    rounded = [0.0 if abs(value) <= _ZERO * largest else float(f"{value:.{_DIGITS}g}") for value in values.flat]
    return np.array(rounded).reshape(values.shape)
