"""The lagged estimate: disturbances of the past as states that later samples still correct (a fixed-lag smoother).

A disturbance c of the past has the covariance v with the error of ξ̂ and the variance σ². A sample with the row h, the
innovation e and its variance α gives

    ĉ += vᵀh e/α,   σ² −= (vᵀh)²/α,   v −= K hᵀv,       and a step   v ← Φ v.
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_state import LagMemory

# Instants that are kept. Where the lag has more samples, not every one is kept, and the estimate is interpolated.
_KEPT = 64


def kept(lag: float) -> int:
    """Return how many instants of the past are kept for a lag (s)."""
    return _KEPT + 1 if lag > 0.0 else 0


def empty_lag(q: int, lag: float) -> LagMemory:
    """Return the memory before the first sample."""
    count = kept(lag)
    return LagMemory(np.full(count, -1.0), np.zeros(count * q), np.zeros(count * q))


def smoothed(lagged: LagMemory, seen: Array, innovation: float, alpha: float) -> LagMemory:
    """Return the memory after an innovation of variance α, whose row sees vᵀh (K q2,) of the past."""
    if not lagged.age.size:
        return lagged
    return LagMemory(
        lagged.age, lagged.value + seen * (innovation / alpha), np.maximum(lagged.variance - seen**2 / alpha, 0.0)
    )


def is_due(lagged: LagMemory, lag: float) -> bool:
    """Return whether the last disturbance that is kept is so old that the one at this sample is kept too."""
    return not 0.0 <= lagged.age[-1] < (1.0 - 1e-9) * lag / _KEPT


def remembered(lagged: LagMemory, d_hat: Array, variance: Array) -> LagMemory:
    """Return the memory with the disturbance d̂ (q2,) at this sample and its variance (q2,)."""
    q = len(d_hat)
    return LagMemory(
        age=np.append(lagged.age[1:], 0.0),
        value=np.append(lagged.value[q:], d_hat),
        variance=np.append(lagged.variance[q:], variance),
    )


def later(lagged: LagMemory, H: float) -> LagMemory:
    """Return the memory H s later."""
    if not lagged.age.size:
        return lagged
    return LagMemory(np.where(lagged.age >= 0.0, lagged.age + H, -1.0), lagged.value, lagged.variance)


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
