"""The columns of a record's noise where its paces change: those of each disturbance apart, and N for all other noise.

A disturbance moves some states only, as a wind along x does not turn a quadrotor. So its noise needs as many columns
as rows. The filter's steps cost in proportion to the columns.
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.log.smooth.smoother import lower_factor
from ndob_fmu.runtime.arrays import Array


def in_few_columns(noise: Array, q: int) -> Array:
    """Return noise (K,N,q2·w + N) of the same covariance, for one of N columns for each direction, those of d first."""
    N = noise.shape[1]
    each = np.split(noise[:, :, : q * N], q, axis=2)
    moved = [np.flatnonzero(one.any(axis=(0, 2))) for one in each]
    w = max(map(len, moved))
    found = np.zeros((len(noise), N, q * w + N))
    for columns, one, rows in zip(of_each_disturbance(found, q), each, moved, strict=True):
        columns[:, rows, : len(rows)] = lower_factor(one[:, rows])
    if noise.shape[2] > q * N:
        found[:, :, q * w :] = lower_factor(noise[:, :, q * N :])
    return found


def of_each_disturbance(noise: Array, q: int) -> list[Array]:
    """Return the columns (…,N,w) of each of q2 disturbances, to be changed in place."""
    return np.split(noise[..., : -noise.shape[-2]], q, axis=-1)
