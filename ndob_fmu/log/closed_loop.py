"""The closed loop of a filter at each row: what the adjoint before its samples is, by that behind the step from it.

    λ = Ψᵀ λ⁺ + b,     Λ = Ψᵀ Λ⁺ Ψ + C,     Ψ = Φ (I − K_p c_p) … (I − K_1 c_1)
    u = v + lᵀ λ⁺,     D = V + lᵀ Λ⁺ l

The rows do not wait for one another here, as those of the filter do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array


class ClosedLoop(NamedTuple):
    """The maps at rows (…).

    Psi (…,N,N): Ψ
    of_state (…,N), of_state_variance (…,N,N): b and C, of the row's own samples
    later (…,N,p): l, what of a unit of u stands behind the step, as the columns of an event do
    earlier (…,N,p): Cov(b, v)
    of_sample (…,p), of_samples_variance (…,p,p): v and V
    """

    Psi: Array
    of_state: Array
    of_state_variance: Array
    later: Array
    earlier: Array
    of_sample: Array
    of_samples_variance: Array


def closed_loop(Phi: Array, rows: Array, gain: Array, innovation: Array, alpha: Array) -> ClosedLoop:
    """Return the maps at rows with steps Φ (…,N,N), as `LinearRecord` and `Forward` have them."""
    *several, p, N = rows.shape
    Psi, b, C = Phi, np.zeros((*several, N)), np.zeros((*several, N, N))
    v, V = np.zeros((*several, p)), np.zeros((*several, p, p))
    earlier, later = np.zeros((*several, N, p)), np.zeros((*several, N, p))
    measured, per_alpha = np.isfinite(alpha), 1.0 / alpha
    for i in range(p - 1, -1, -1):
        c, K = rows[..., i, :] * measured[..., i, None], gain[..., i, :]
        seen = np.matmul(C, K[..., None])[..., 0]
        own = per_alpha[..., i] + (K * seen).sum(axis=-1)
        across = -np.matmul(K[..., None, :], earlier)[..., 0, :]  # with the later samples of the row
        earlier = earlier + c[..., :, None] * across[..., None, :]
        earlier[..., i] = c * own[..., None] - seen
        V[..., i, :] = V[..., :, i] = across
        V[..., i, i] = own
        v[..., i] = innovation[..., i] * per_alpha[..., i] - (K * b).sum(axis=-1)
        b = b + c * v[..., i, None]
        added = c[..., :, None] * (0.5 * own[..., None] * c - seen)[..., None, :]
        C = C + added + np.swapaxes(added, -1, -2)
        later[..., i] = -np.matmul(Psi, K[..., None])[..., 0]
        Psi = Psi + later[..., i, None] * c[..., None, :]
    return ClosedLoop(Psi, b, C, later, earlier, v, V)
