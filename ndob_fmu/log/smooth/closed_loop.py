"""The closed loop of a filter at each row: what the adjoint before its samples is, by that behind the step from it.

    λ = Ψᵀ λ⁺ + Hᵀ e/α,     Λ = Ψᵀ Λ⁺ Ψ + Hᵀ H/α,     Ψ = Φ (I − K_p c_p) … (I − K_1 c_1) = Φ − Φ K H
    u = Wᵀ e/α + lᵀ λ⁺,     D = Wᵀ W/α + lᵀ Λ⁺ l,       l = −Φ K W,   H = W C

The rows do not wait for one another here, as those of the filter do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array


class ClosedLoop(NamedTuple):
    """The maps at rows (…).

    Psi (…,N,N): Ψ
    of_state (…,N), of_state_variance (…,N,N): λ and Λ of the row's own samples
    later (…,N,p): l, what of a unit of u stands behind the step, as the columns of an event do
    of_sample (…,p), of_samples_variance (…,p,p): u of the row's own samples, and their covariance
    earlier (…,N,p): the covariance of that λ with that u
    """

    Psi: Array
    of_state: Array
    of_state_variance: Array
    later: Array
    earlier: Array
    of_sample: Array
    of_samples_variance: Array

    def before(self, k: int, score: Array, variance: Array) -> tuple[Array, Array]:
        """Return λ and Λ before the samples of row k, by those behind its step."""
        back = np.swapaxes(self.Psi[k], -1, -2)
        variance = np.matmul(np.matmul(back, variance), self.Psi[k]) + self.of_state_variance[k]
        return np.matmul(back, score[..., None])[..., 0] + self.of_state[k], variance


def closed_loop(Phi: Array, rows: Array, gain: Array, innovation: Array, alpha: Array) -> ClosedLoop:
    """Return the maps at rows with steps Φ (…,N,N), as `LinearRecord` and `Forward` have them."""
    p = rows.shape[-2]
    K, per_alpha = np.swapaxes(gain, -1, -2), 1.0 / alpha
    # A sample shows the gains of those before it: of the state before all, the innovations are those of the rows W C.
    before, W = np.tril(rows @ K, -1), np.eye(p)
    for _ in range(p - 1):
        W = np.eye(p) - before @ W
    W = np.broadcast_to(W, before.shape)
    H, behind = W @ rows, Phi @ K
    weighted, told = per_alpha[..., None] * W, (innovation * per_alpha)[..., None, :]
    Ht, Wt = np.swapaxes(H, -1, -2), np.swapaxes(W, -1, -2)
    return ClosedLoop(
        Psi=Phi - behind @ H,
        of_state=(told @ H)[..., 0, :],
        of_state_variance=Ht @ (per_alpha[..., None] * H),
        later=-behind @ W,
        earlier=Ht @ weighted,
        of_sample=(told @ W)[..., 0, :],
        of_samples_variance=Wt @ weighted,
    )
