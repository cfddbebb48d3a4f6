"""Modes that neither d nor f reaches and that do not decay, as a body's heading behind known thrusts.

Their covariance in a filter without noise on them falls like 1/t and has no limit, although no gain needs one. So the
design takes them to drift, so slowly that nothing else notices.
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.zeros import AXIS_TOLERANCE, RANK_TOLERANCE


def idle_directions(A: Array, channels: Array, units: Array) -> Array:
    """Return directions (n,·) of the states that the channels (n,·) do not reach; none where all their modes decay.

    units (n,): in which A (n,n) has entries near one rate.
    """
    n = len(A)
    A = A * units / units[:, None]
    rate = max(float(np.linalg.norm(A)), 1e-300)
    sizes = np.linalg.norm(channels / units[:, None], axis=0)
    block = channels / units[:, None] / np.where(sizes > 0.0, sizes, 1.0)
    T = np.zeros((n, 0))
    for _ in range(n):
        block = block - T @ (T.T @ block)
        U, sigma, _ = np.linalg.svd(block, full_matrices=False)
        rank = int(np.sum(sigma > RANK_TOLERANCE))
        if rank == 0 or T.shape[1] == n:
            break
        T = np.linalg.qr(np.hstack([T, U[:, :rank]]))[0]
        block = A @ T[:, T.shape[1] - rank :] / rate
    rest = np.linalg.qr(np.hstack([T, np.eye(n)]))[0][:, T.shape[1] :]
    if rest.shape[1] == 0:
        return rest
    modes = np.linalg.eigvals(rest.T @ A @ rest).real
    if np.max(modes) < -AXIS_TOLERANCE * rate:
        return np.zeros((n, 0))
    return np.asarray(units[:, None] * rest)
