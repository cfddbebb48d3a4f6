"""The lagged estimate: disturbances of the past as states that later samples still correct (a fixed-lag smoother).

A disturbance c of the past has the covariance v with the error of ξ̂ and the variance σ². A sample with the row h, the
innovation e and its variance α gives

    ĉ += vᵀh e/α,   σ² −= (vᵀh)²/α,   v −= K hᵀv,       and a step   v ← Φ v.

A jump of d that the filter does not know adds μ_c ν to the error of ĉ, as it adds μ ν to that of ξ̂ (`jump_bank`). At
first μ_c is what the jump has done to d at that time, 0 where the jump came later. A sample takes vᵀh hᵀμ/α from it.
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


def empty_lag(q: int, lag: float, signatures: int) -> LagMemory:
    """Return the memory before the first sample, with so many signatures for each disturbance of the past."""
    count = kept(lag)
    return LagMemory(np.full(count, -1.0), np.zeros(count * q), np.zeros(count * q), np.zeros((count * q, signatures)))


def smoothed(lagged: LagMemory, seen: Array, of_jumps: Array, innovation: float, alpha: float) -> LagMemory:
    """Return the memory after an innovation of variance α.

    seen (K q2,): vᵀh, which its row sees of the past
    of_jumps (4 L q2,): what jumps of one add to the innovation
    """
    if not lagged.age.size:
        return lagged
    return LagMemory(
        lagged.age,
        lagged.value + seen * (innovation / alpha),
        np.maximum(lagged.variance - seen**2 / alpha, 0.0),
        lagged.signatures - (seen / alpha)[:, None] * of_jumps,
    )


def moved(lagged: LagMemory, shift: Array, more: Array) -> LagMemory:
    """Return the memory with its values (K q2,) shifted, and more variance (K q2,)."""
    return LagMemory(lagged.age, lagged.value + shift, lagged.variance + more, lagged.signatures)


def without_signatures(lagged: LagMemory) -> LagMemory:
    """Return the memory for a bank without hypotheses."""
    return LagMemory(lagged.age, lagged.value, lagged.variance, np.zeros_like(lagged.signatures))


def with_new_signatures(lagged: LagMemory, newest: Array) -> LagMemory:
    """Return the memory with signatures of jumps in the step that begins in place of the oldest ones.

    newest (q2,4 q2): theirs in d at the sample, for where that is kept
    """
    if not lagged.age.size:
        return lagged
    q, count = newest.shape
    added = np.zeros((len(lagged.signatures), count))
    if lagged.age[-1] == 0.0:
        added[len(added) - q :] = newest
    signatures = np.concatenate([lagged.signatures[:, count:], added], axis=1)
    return LagMemory(lagged.age, lagged.value, lagged.variance, signatures)


def is_due(lagged: LagMemory, lag: float) -> bool:
    """Return whether the last disturbance that is kept is so old that the one at this sample is kept too."""
    return not 0.0 <= lagged.age[-1] < (1.0 - 1e-9) * lag / _KEPT


def remembered(lagged: LagMemory, d_hat: Array, variance: Array, signatures: Array) -> LagMemory:
    """Return the memory with the disturbance d̂ (q2,) at this sample, its variance (q2,) and signatures (q2,·)."""
    q = len(d_hat)
    return LagMemory(
        age=np.append(lagged.age[1:], 0.0),
        value=np.append(lagged.value[q:], d_hat),
        variance=np.append(lagged.variance[q:], variance),
        signatures=np.concatenate([lagged.signatures[q:], signatures]),
    )


def later(lagged: LagMemory, H: float) -> LagMemory:
    """Return the memory H s later."""
    if not lagged.age.size:
        return lagged
    age = np.where(lagged.age >= 0.0, lagged.age + H, -1.0)
    return LagMemory(age, lagged.value, lagged.variance, lagged.signatures)


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
