"""The estimate of each row from the samples up to a lag behind it: the adjoint over a window, for all rows at once.

From the row behind a sample to the row before it, the adjoint goes by the closed loop (`closed_loop`),

    λ_k = Ψ_kᵀ λ_{k+1} + b_k,     Λ_k = Ψ_kᵀ Λ_{k+1} Ψ_k + C_k

In blocks as long as the window, the window of a row is the rest of its block and the beginning of the next one. Both
follow from row to row, for all blocks side by side (van Herk, 1992).
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.log.smooth.c_library import c_library
from ndob_fmu.log.smooth.linear_record import Adjoint, Forward, LinearRecord
from ndob_fmu.log.smooth.smoother import closed_loops
from ndob_fmu.runtime.arrays import Array


def lagged_adjoint(record: LinearRecord, found: Forward, rows: int) -> Adjoint:
    """Return the adjoint at each row from its own samples and those of some more rows.

    It has no scores of single samples.
    """
    none, in_c = np.zeros(found.alpha.shape), c_library(len(record.rows))
    if in_c is not None:
        return Adjoint(*in_c.lagged_adjoint(record, found, rows), none, none)
    Psi, b, C = _in_blocks(record, found, min(rows + 1, len(record.rows)))
    starts_b, starts_C = np.zeros_like(b), np.zeros_like(C)  # of the first rows of a block
    A = np.broadcast_to(np.eye(Psi.shape[-1]), Psi[0].shape)
    for r in range(len(Psi) - 1):
        At = np.swapaxes(A, 1, 2)
        starts_b[r + 1] = starts_b[r] + (At @ b[r, ..., None])[..., 0]
        starts_C[r + 1] = starts_C[r] + At @ C[r] @ A
        A = Psi[r] @ A
    A, rest_b, rest_C = np.broadcast_to(np.eye(Psi.shape[-1]), Psi[0].shape), np.zeros_like(b[0]), np.zeros_like(C[0])
    for r in range(len(Psi) - 1, -1, -1):
        A, back = A @ Psi[r], np.swapaxes(Psi[r], 1, 2)
        rest_b, rest_C = (back @ rest_b[..., None])[..., 0] + b[r], back @ rest_C @ Psi[r] + C[r]
        At = np.swapaxes(A[:-1], 1, 2)
        b[r], C[r] = rest_b, rest_C
        b[r, :-1] += (At @ starts_b[r, 1:, :, None])[..., 0]
        C[r, :-1] += At @ starts_C[r, 1:] @ A[:-1]
    K = len(record.rows)
    of_state, variance = (np.swapaxes(one, 0, 1).reshape(-1, *one.shape[2:])[:K] for one in (b, C))
    return Adjoint(of_state, variance, none, none)


def _in_blocks(record: LinearRecord, found: Forward, length: int) -> tuple[Array, Array, Array]:
    """Return Ψ, b and C of blocks (length,blocks,…); rows behind the record change nothing."""
    K, _, N = record.rows.shape
    rows = -(-K // length) * length
    Psi, b, C = np.empty((rows, N, N)), np.zeros((rows, N)), np.zeros((rows, N, N))
    Psi[K:] = np.eye(N)
    for some, loop in closed_loops(record, found):
        Psi[some], b[some], C[some] = loop.Psi, loop.of_state, loop.of_state_variance
    Psi, b, C = (np.swapaxes(one.reshape(-1, length, *one.shape[1:]), 0, 1).copy() for one in (Psi, b, C))
    return Psi, b, C
