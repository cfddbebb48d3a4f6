"""The slopes of the likelihood L by the logarithms of noise and pace: one pass back along a record tells all of them.

With the scores u, λ of samples and states and their variances D, Λ, as `smoother` has them, and N_j of disturbance j

    ∂L/∂log R_i = ½ Σ R_i (u_i² − D_i),     ∂L/∂log q_j = ½ Σ tr(N_j N_jᵀ (λλᵀ − Λ))

(Koopman and Shephard, 1992).
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.log.fit.noise_columns import of_each_disturbance
from ndob_fmu.log.smooth.linear_record import Adjoint, LinearRecord
from ndob_fmu.runtime.arrays import Array


def covariances_of_pace(record: LinearRecord, q: int) -> Array:
    """Return N_j N_jᵀ (L-1,S,q2,N,N) of pieces, for the noise behind each of q2 disturbances."""
    return np.stack([one @ np.swapaxes(one, -1, -2) for one in of_each_disturbance(record.noise, q)], axis=2)


def noise_slopes(record: LinearRecord, found: Adjoint, of_pace: Array, factors: Array) -> Array:
    """Return the slopes (p + q2,) of pieces whose adjoint is found.

    of_pace: as `covariances_of_pace`, before the factors (q2,) that the intensities have now
    """
    of_samples = record.variance * (found.of_sample**2 - found.of_sample_variance)
    score, rows = found.of_state[1:], len(of_pace) * of_pace.shape[1]
    excess = score[..., None] * score[..., None, :] - found.of_state_variance[1:]
    of_d = np.einsum("ra,rqa->q", excess.reshape(rows, -1), of_pace.reshape(rows, len(factors), -1))
    return 0.5 * np.concatenate([of_samples.sum(axis=(0, 1)), factors * of_d])
