"""A plant's equations outside the ranges where it works: continued by their tangent at the nearest point inside.

    F(x, u) = F(x̄, ū) + ∂F/∂x (x − x̄) + ∂F/∂u (u − ū),   slopes at (x̄, ū),   x̄ and ū clipped to the ranges

So an estimate outside is still corrected in the right direction, and nothing is evaluated where it could overflow, as
1/gap or exp(−E/RT). Terms that are linear stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations, Vector

Function = Callable[[Vector, Vector, Vector, Vector], tuple[float, ...]]


def continued(equations: Equations) -> Equations:
    """Return the plant with its equations continued outside the ranges; the plant itself where it has none."""
    if not equations.ranges:
        return equations
    eq = equations
    n, m, p = len(eq.states), len(eq.inputs), len(eq.outputs)
    of_x, of_u = _limits(eq, eq.states), _limits(eq, eq.inputs)

    def inside(function: Function) -> Function:
        def clipped(x: Vector, u: Vector, d: Vector, parameters: Vector) -> tuple[float, ...]:
            return function(_clipped(x, of_x), _clipped(u, of_u), d, parameters)

        return clipped

    def moved(rows: slice, x: Vector, u: Vector, d: Vector, parameters: Vector) -> Array:
        """Return what x − x̄ and u − ū add to the rows of [ẋ; y]."""
        x_in, u_in = _clipped(x, of_x), _clipped(u, of_u)
        by_x = np.array(eq.linearisation(x_in, u_in, d, parameters)).reshape(n + p, -1)[rows, :n]
        by_u = np.array(eq.input_slopes(x_in, u_in, d, parameters)).reshape(n + p, m)[rows]
        return np.asarray(by_x @ np.subtract(x, x_in) + by_u @ np.subtract(u, u_in))

    def derivatives(x: Vector, u: Vector, d: Vector, parameters: Vector) -> tuple[float, ...]:
        at = eq.derivatives(_clipped(x, of_x), _clipped(u, of_u), d, parameters)
        if _is_inside(x, of_x) and _is_inside(u, of_u):
            return at
        return tuple((np.array(at) + moved(slice(n), x, u, d, parameters)).tolist())

    def output(x: Vector, u: Vector, parameters: Vector) -> tuple[float, ...]:
        at = eq.output(_clipped(x, of_x), _clipped(u, of_u), parameters)
        if _is_inside(x, of_x) and _is_inside(u, of_u):
            return at
        no_disturbance = (0.0,) * len(eq.disturbances)
        return tuple((np.array(at) + moved(slice(n, n + p), x, u, no_disturbance, parameters)).tolist())

    return replace(
        equations,
        derivatives=derivatives,
        output=output,
        linearisation=inside(eq.linearisation),
        input_slopes=inside(eq.input_slopes),
        sensitivity=inside(eq.sensitivity),
    )


def _limits(equations: Equations, names: Sequence[str]) -> tuple[tuple[float, float], ...]:
    return tuple(equations.ranges.get(name, (-np.inf, np.inf)) for name in names)


def _clipped(values: Vector, limits: tuple[tuple[float, float], ...]) -> list[float]:
    return [min(max(float(value), low), high) for value, (low, high) in zip(values, limits, strict=True)]


def _is_inside(values: Vector, limits: tuple[tuple[float, float], ...]) -> bool:
    return all(low <= value <= high for value, (low, high) in zip(values, limits, strict=True))
