"""Signals over time, thinned for a page without losing what sticks out, and which of them belong together."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_MOST_POINTS = 2000
_ESTIMATE = "_hat"
_TRUTHS = ("{}_total", "{}")


def thinned(values: Array, most: int = _MOST_POINTS) -> NDArray[np.intp]:
    """Return which rows of (rows,) to draw: all, or of each of equal stretches the least and the largest value.

    The first and the last row are always among them.
    """
    rows = len(values)
    if rows <= most:
        return np.arange(rows)
    edges = np.linspace(0, rows, most // 2 + 1).astype(int)
    kept = {0, rows - 1}
    known = values[np.isfinite(values)]
    finite = np.where(np.isfinite(values), values, known[0] if len(known) else 0.0)
    for first, end in pairwise(edges):
        stretch = finite[first:end]
        kept |= {int(first + stretch.argmin()), int(first + stretch.argmax())}
    return np.array(sorted(kept))


def estimates(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return (true signal, its estimate): ``X.name_hat`` goes with another component's ``name_total`` or ``name``."""
    pairs = []
    for name in names:
        component, _, variable = name.partition(".")
        if not variable.endswith(_ESTIMATE):
            continue
        wanted = [truth.format(variable.removesuffix(_ESTIMATE)) for truth in _TRUTHS]
        others = {other.partition(".")[2]: other for other in reversed(names) if other.partition(".")[0] != component}
        pairs += [(others[truth], name) for truth in wanted if truth in others][:1]
    return pairs
