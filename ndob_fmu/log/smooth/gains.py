"""What an event explains of a record, by the scores of the smoother (`event_search` has the equation)."""

from __future__ import annotations

import numpy as np

from ndob_fmu.log.smooth.c_library import c_library
from ndob_fmu.runtime.arrays import Array


def explained_by(columns: Array, scores: Array, variances: Array) -> Array:
    """Return what events with columns J (K,N,c) explain, by scores λ (K,N) and their variances Λ (K,N,N).

    −∞ where rounding errors leave no variance.
    """
    in_c = c_library(len(columns))
    if in_c is None:
        score = np.einsum("knc,kn->kc", columns, scores)
        return eliminated(score, np.swapaxes(columns, 1, 2) @ variances @ columns)
    return in_c.explained_by(columns, scores, variances)


def eliminated(score: Array, variance: Array) -> Array:
    """Return ½ (lᵀ (I + M)⁻¹ l − log det (I + M)) for l (K,c) and M (K,c,c) by elimination, all rows at once."""
    c = score.shape[1]
    left, gained = np.concatenate([np.eye(c) + variance, score[:, :, None]], axis=2), np.zeros(len(score))
    for _ in range(c):
        is_left = left[:, 0, 0] > 0.0
        pivot = np.where(is_left, left[:, 0, 0], 1.0)
        gained[~is_left] = -np.inf
        row = left[:, 0, 1:] / pivot[:, None]
        gained += left[:, 0, -1] * row[:, -1] - np.log(pivot)
        left = left[:, 1:, 1:] - left[:, 1:, :1] * row[:, None]
    return 0.5 * gained
