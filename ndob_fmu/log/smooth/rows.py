"""Some rows of a record, as an index of its arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Rows = slice | NDArray[np.intp]


def not_copied(rows: NDArray[np.intp]) -> Rows:
    """Return rows as a slice where they follow one another: an array of a slice is no copy."""
    return slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) and rows[-1] - rows[0] == len(rows) - 1 else rows
