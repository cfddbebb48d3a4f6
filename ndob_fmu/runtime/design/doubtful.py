"""Equations that may be wrong without any disturbance that says so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array


def doubtful_equations(A: Array, B: Array, C: Array, channels: Array, noisy: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return for each ẋ_i (n,) whether samples can contradict it, and nothing else drives the state.

    What is wrong with an equation in which d acts is taken for d. An equation that has one other state alone, as that
    of an angle has its rate, is exact. No samples contradict each other where no more outputs than disturbances are.

    A (n,n), B (n,m), C (p,n): of the plant, linearised.
    channels (n,q): of the disturbances.
    noisy (n,): whether a state has a noise of its own.
    """
    exact = (np.sum(A != 0.0, axis=1) == 1) & (np.diag(A) == 0.0) & ~np.any(B != 0.0, axis=1)
    explained = np.any(channels != 0.0, axis=1) | noisy
    return np.asarray(~(exact | explained) & (len(C) > channels.shape[1]))
