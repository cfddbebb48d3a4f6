"""Signals thinned for a page so that their peaks stay."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array

_MOST_POINTS = 2000


def thinned(values: Array, most: int = _MOST_POINTS) -> NDArray[np.intp]:
    """Return which rows of (rows,) to draw: all, or of each of equal stretches the least and the largest value.

    The first and the last row are always among them, and of each stretch with values that are not finite one such
    row: a gap in the signal stays a gap in the line.
    """
    rows = len(values)
    if rows <= most:
        return np.arange(rows)
    edges = np.linspace(0, rows, most // 2 + 1).astype(int)
    kept = {0, rows - 1}
    usable = np.isfinite(values)
    for first, end in pairwise(edges):
        here = usable[first:end]
        if here.any():
            stretch = values[first:end]
            kept.add(int(first + np.where(here, stretch, np.inf).argmin()))
            kept.add(int(first + np.where(here, stretch, -np.inf).argmax()))
        if not here.all():
            kept.add(int(first + here.argmin()))
    return np.array(sorted(kept))
