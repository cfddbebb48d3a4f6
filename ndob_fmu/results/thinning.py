"""Signals thinned for a page so that their peaks stay."""

from __future__ import annotations

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
    # A row of these for each stretch, of which the shorter ones do not have the last entry.
    places = edges[:-1, None] + np.arange(int(np.diff(edges).max()))
    inside = places < edges[1:, None]
    stretches, usable = values[np.minimum(places, rows - 1)], np.isfinite(values)[np.minimum(places, rows - 1)]
    here, gap = inside & usable, inside & ~usable
    kept = [np.array([0, rows - 1])]
    for some, place in (
        (here, np.where(here, stretches, np.inf).argmin(axis=1)),
        (here, np.where(here, stretches, -np.inf).argmax(axis=1)),
        (gap, gap.argmax(axis=1)),
    ):
        kept.append((edges[:-1] + place)[some.any(axis=1)])
    return np.unique(np.concatenate(kept))
