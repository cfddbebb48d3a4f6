"""The estimate of each row from the samples up to a lag behind it: the adjoint over a window, for all rows at once.

From the row behind a sample to the row before it, `smoother.backward` maps λ and Λ as

    λ_k = A_kᵀ λ_{k+1} + b_k,     Λ_k = A_kᵀ Λ_{k+1} A_k + C_k

Two such maps one after the other are one. So windows of 1, 2, 4, … rows follow from one another, and a window of L rows
takes log₂ L products (Kogge and Stone's scan).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndob_fmu.log.smoother import Adjoint, Forward, LinearRecord, closed_loops
from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True)
class _Windows:
    """The maps A (K,N,N), b (K,N), C (K,N,N) over a window of rows from each row on."""

    A: Array
    b: Array
    C: Array

    def then(self, later: _Windows, length: int) -> _Windows:
        """Return these windows of some length, followed by others; at the end of the record they stay short."""
        K = len(self.b)
        inner = max(K - length, 0)
        At = np.swapaxes(self.A[:inner], 1, 2)
        A, b, C = self.A.copy(), self.b.copy(), self.C.copy()
        A[:inner] = later.A[length:] @ self.A[:inner]
        b[:inner] += (At @ later.b[length:, :, None])[:, :, 0]
        C[:inner] += At @ later.C[length:] @ self.A[:inner]
        return _Windows(A, b, C)


def lagged_adjoint(record: LinearRecord, found: Forward, rows: int) -> Adjoint:
    """Return the adjoint at each row from its own samples and those of some more rows.

    It has no scores of single samples.
    """
    loops = [loop for _, loop in closed_loops(record, found)][::-1]
    one = _Windows(
        *(np.concatenate(part) for part in zip(*((p.Psi, p.of_state, p.of_state_variance) for p in loops), strict=True))
    )
    K, N = one.b.shape
    windows, length = _Windows(np.tile(np.eye(N), (K, 1, 1)), np.zeros((K, N)), np.zeros((K, N, N))), 0
    wanted, power = min(rows + 1, K), 1
    while wanted:
        if wanted & 1:
            windows = windows.then(one, length) if length else one
            length += power
        wanted >>= 1
        if wanted:
            one, power = one.then(one, power), 2 * power
    none = np.zeros(found.alpha.shape)
    return Adjoint(windows.b, windows.C, none, none)
