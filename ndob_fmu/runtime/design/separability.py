"""Whether samples can tell sensor offsets and model parameters apart from a disturbance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.numerics.zeros import RANK_TOLERANCE, balance

_PART = 1e-6  # of a solution of length one: a smaller offset in it counts as zero
_IMITATED = 1e-9  # of a parameter's effect: what no disturbance imitates, and counts as zero
# Points around x̂₀ at which the effect of a parameter is compared with that of the disturbance.
_POINTS = 6


def inseparable_offsets(
    equations: Equations, parameters: Vector, x_hat: Vector, biased: Sequence[int]
) -> tuple[int, ...]:
    """Return those of the `biased` outputs whose constant offset b cannot be told apart from a constant disturbance.

    For the plant linearised at x̂₀ (n,) with u = 0 that is so where F x + G_d d = 0 and C x + b = 0 have a solution with
    b ≠ 0: the outputs then stay as they are without offset and disturbance.
    """
    plant = balance(*_linearised(equations, parameters, x_hat, (0.0,) * len(equations.inputs)))
    n, q = plant.G.shape
    p = len(plant.C)
    offsets = np.eye(p)[:, list(biased)]
    both = np.block([[plant.A, plant.G, np.zeros((n, len(biased)))], [plant.C, np.zeros((p, q)), offsets]])
    _, values, directions = np.linalg.svd(both)
    rank = int(np.sum(values > RANK_TOLERANCE * values[0]))
    solutions = directions[rank:, n + q :]
    return tuple(i for place, i in enumerate(biased) if np.any(np.abs(solutions[:, place]) > _PART))


def inseparable_parameters(
    equations: Equations, parameters: Vector, x_hat: Vector, x_std: Vector, uncertain: Sequence[int]
) -> tuple[int, ...]:
    """Return those of the `uncertain` parameters whose error some disturbance d(t) imitates exactly.

    That is so where ∂F/∂p lies in the span of the columns of G_d, and y does not depend on p. It is judged at points
    around x̂₀ (n,), as far away as x_std (n,) says.
    """
    n, m, q = len(equations.states), len(equations.inputs), len(equations.disturbances)
    effect, told = np.zeros(len(parameters)), np.zeros(len(parameters))
    for k in range(_POINTS):
        x = [v + s * np.sin((k + 1.0) * (i + 1.0)) for i, (v, s) in enumerate(zip(x_hat, x_std, strict=True))]
        u = [float(np.cos((k + 1.0) * (i + 1.0))) for i in range(m)]
        _, G_d, C = _linearised(equations, parameters, x, u)
        slopes = np.array(equations.sensitivity(x, u, (0.0,) * q, parameters), dtype=float).reshape(n + len(C), -1)
        rest = slopes.copy()
        rest[:n] -= G_d @ np.linalg.lstsq(G_d, slopes[:n], rcond=None)[0]
        effect, told = effect + np.sum(slopes**2, axis=0), told + np.sum(rest**2, axis=0)
    return tuple(i for i in uncertain if told[i] <= _IMITATED**2 * effect[i])


def _linearised(equations: Equations, parameters: Vector, x: Vector, u: Vector) -> tuple[Array, Array, Array]:
    """Return ∂F/∂x (n,n), G_d (n,q2) and ∂h/∂x (p,n) at x and u, with d = 0."""
    n, q, p = len(equations.states), len(equations.disturbances), len(equations.outputs)
    both = np.array(equations.linearisation(x, u, (0.0,) * q, parameters), dtype=float).reshape(n + p, n + q)
    return both[:n, :n], both[:n, n:], both[n:, :n]
