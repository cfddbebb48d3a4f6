"""Signals over time: the spans in which a flag is true, and the range of an axis that shows the usual values."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array

_MOST_SPANS = 200
_ESTIMATE = "_hat"
_TRUTHS = ("{}_total", "{}")
# An axis shows all values if their range is at most this many times that between the 1 % and 99 % quantiles.
_FAR = 2.5


def spans(time: Array, holds: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the intervals (s) in which a flag (rows,) is true; row k is for the step that ends at ``time[k]``.

    There are at most 200; of more, the closest ones are joined.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(int)))
    found = [(float(time[max(a - 1, 0)]), float(time[b - 1])) for a, b in edges.reshape(-1, 2)]
    if len(found) > _MOST_SPANS:
        gaps = np.array([later[0] - earlier[1] for earlier, later in pairwise(found)])
        kept = np.sort(np.argsort(-gaps, kind="stable")[: _MOST_SPANS - 1])
        starts = [found[0][0], *(found[k + 1][0] for k in kept)]
        found = list(zip(starts, [*(found[k][1] for k in kept), found[-1][1]], strict=True))
    return found


def usual_range(*signals: Array, usual: NDArray[np.bool_] | None = None) -> tuple[float, float] | None:
    """Return the range of an axis for the usual values of signals, None where that of all their values shows them.

    A peak of a few rows, as at the start, otherwise makes a line of all the rest. usual (rows,): None means all rows.
    """
    known = [signal[np.isfinite(signal)] for signal in signals]
    looked_at = known if usual is None else [signal[np.isfinite(signal) & usual] for signal in signals]
    looked_at = [signal for signal in looked_at if len(signal)]
    if not looked_at:
        return None
    low, high = (pick(np.quantile(signal, q) for signal in looked_at) for pick, q in ((min, 0.01), (max, 0.99)))
    least, most = (pick([pick(signal) for signal in known if len(signal)]) for pick in (np.min, np.max))
    if most - least <= _FAR * (high - low) or high == low:
        return None
    margin = 0.25 * (high - low)
    return float(low - margin), float(high + margin)


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
