"""Uncertain parameters that act as the disturbance does, so that no sample tells their errors from d.

Where ẋ = F + G_d (d + W θ̃), the observer estimates δ = d + W θ̃ in place of d. So θ̃ moves neither ξ̂ nor its covariance,
but widens the error bar of d̂, by W P_θ Wᵀ. With θ̃ in the covariance, a filter that must not correct θ̂ would correct d̂
at each sample for what this sample says of θ̃, and go back at the next one. A parameter that acts as several
disturbances at once stays there: they tell of it together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations, Vector

# A parameter acts as d does where at so many points what else it does is a rounding error.
_POINTS = 5
_ROUNDING = 1e-9


def act_as_disturbance(
    equations: Equations, parameters: Vector, which: Sequence[int], x: Vector, u: Vector, size: Array
) -> Array:
    """Return 1 for each of these parameters (k,) that acts as one of the disturbances and in no other way, else 0.

    x (n,), u (m,): near which they are tried
    size (n + p,): of states and outputs
    """
    n, q = len(equations.states), len(equations.disturbances)
    act: Array = np.ones(len(which))
    through: Array = np.zeros((q, len(which)))
    for point in range(_POINTS):
        near_x = [value + float(size[i]) * _share(point, i) for i, value in enumerate(x)]
        near_u = [value + _share(point, n + i) for i, value in enumerate(u)]
        d = [_share(point, n + len(u) + i) for i in range(q)]
        try:
            both = np.array(equations.linearisation(near_x, near_u, d, parameters)).reshape(len(size), n + q)
            slopes = np.array(equations.sensitivity(near_x, near_u, d, parameters)).reshape(len(size), -1)
        except (ArithmeticError, ValueError):
            return np.zeros(len(which))
        slopes = slopes[:, list(which)] / size[:, None]
        channels = both[:n, n:] / size[:n, None]
        W = along_disturbance(both[:n, n:], slopes[:n] * size[:n, None], size)
        rest: Array = slopes.copy()
        rest[:n] -= channels @ W
        limit = _ROUNDING * np.abs(slopes).max(axis=0)
        act = act * (np.abs(rest).max(axis=0) <= limit)
        through = np.maximum(through, np.where(np.abs(channels).max(axis=0)[:, None] * np.abs(W) > limit, 1.0, 0.0))
    return np.asarray(act * (through.sum(axis=0) <= 1.0))


def along_disturbance(G_d: Array, slopes: Array, size: Array) -> Array:
    """Return W (q2,k), with which G_d W comes nearest to slopes (n,k), for states of a size (n or more,)."""
    n = len(G_d)
    return np.asarray(np.linalg.pinv(G_d / size[:n, None]) @ (slopes / size[:n, None]))


def _share(point: int, place: int) -> float:
    """Return a number in (0, 1), another for each point and place."""
    value = (point + 1.0) * float(np.sqrt(2.0 + place))
    return value - float(np.floor(value))
