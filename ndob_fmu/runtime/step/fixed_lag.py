"""The lagged estimate: disturbances of the past as states that later samples still correct (a fixed-lag smoother).

A disturbance c of the past has the covariance v with the error of ξ̂ and the variance σ². A sample with the row h, the
innovation e and its variance α gives

    ĉ += vᵀh e/α,   σ² −= (vᵀh)²/α,   v −= K hᵀv,       and a step   v ← Φ v.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_state import LagMemory

# Instants that are kept. Where the lag has more samples, not every one is kept, and the estimate is interpolated.
_KEPT = 64


def empty_lag(rows: int, q: int, lag: float) -> LagMemory:
    """Return the memory before the first sample."""
    kept = _KEPT + 1 if lag > 0.0 else 0
    return LagMemory(np.full(kept, -1.0), np.zeros(kept * q), np.zeros(kept * q), np.zeros((rows, kept * q)))


def smoothed(lagged: LagMemory, row: Array, K: Array, innovation: float, alpha: float) -> LagMemory:
    """Return the memory after a sample with the row h (rows,), the gain K (rows,) and an innovation of variance α."""
    if not lagged.age.size:
        return lagged
    seen = row @ lagged.covariance
    return replace(
        lagged,
        value=lagged.value + seen * (innovation / alpha),
        variance=np.maximum(lagged.variance - seen**2 / alpha, 0.0),
        covariance=lagged.covariance - K[:, None] * seen,
    )


def remembered(lagged: LagMemory, d_hat: Array, rows_of_d: Array, factor: Array, lag: float) -> LagMemory:
    """Return the memory with the disturbance d̂ (q2,) at this sample, if it is far enough from the last one kept.

    rows_of_d (q2,·): its rows of the factor (rows,·) of the covariance.
    """
    if not lagged.age.size:
        return lagged
    newest = lagged.age[-1]
    if 0.0 <= newest < (1.0 - 1e-9) * lag / _KEPT:
        return lagged
    q = len(d_hat)
    return LagMemory(
        age=np.append(lagged.age[1:], 0.0),
        value=np.append(lagged.value[q:], d_hat),
        variance=np.append(lagged.variance[q:], np.sum(rows_of_d**2, axis=1)),
        covariance=np.hstack([lagged.covariance[:, q:], factor @ rows_of_d.T]),
    )


def at_lag(lagged: LagMemory, lag: float, q: int) -> tuple[Array, Array]:
    """Return the disturbance (q2,) a lag (s) ago and its standard deviation (q2,).

    It is interpolated between two instants, and the oldest one where none is so old.
    """
    value, std = lagged.value.reshape(-1, q), np.sqrt(lagged.variance).reshape(-1, q)
    first = int(np.argmax(lagged.age >= 0.0))
    older = first
    for i in range(first, len(lagged.age)):
        if lagged.age[i] >= lag * (1.0 - 1e-9):
            older = i
    newer = min(older + 1, len(lagged.age) - 1)
    span = lagged.age[older] - lagged.age[newer]
    share = min(max((lagged.age[older] - lag) / span, 0.0), 1.0) if span > 0.0 else 0.0
    if share <= 1e-9:
        return value[older], std[older]
    return (1.0 - share) * value[older] + share * value[newer], (1.0 - share) * std[older] + share * std[newer]
