"""The plant linearised where it works: what method 2 is tuned for and judged by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.zeros import ComplexArray, balance

Ranges = Mapping[str, tuple[float, float]]

# Points that are tried besides the first one, where that tells nothing: shares of the way across each range.
_SHARES = (0.5, 0.25, 0.75)


def middle_input(inputs: Sequence[str], ranges: Ranges) -> tuple[float, ...]:
    """Return the input (m,) about which to linearise: in the middle of its range, 0 without one."""
    return tuple(0.5 * sum(ranges[name]) if name in ranges else 0.0 for name in inputs)


def largest_input(inputs: Sequence[str], ranges: Ranges) -> tuple[float, ...]:
    """Return the size (m,) of the input: the largest in its range, 1 without one."""
    return tuple(max(abs(ranges[name][0]), abs(ranges[name][1])) if name in ranges else 1.0 for name in inputs)


def tangent(equations: Equations, parameters: Vector, x_hat: Vector) -> LinearPart | None:
    """Return the plant linearised at x̂₀ (n,), without f; None where it cannot be evaluated.

    Where the disturbance moves nothing at x̂₀, or no output shows a state, other points of the ranges are tried.
    """
    first = tangent_at(equations, parameters, x_hat, middle_input(equations.inputs, equations.ranges))
    if first is not None and _tells(first):
        return first
    for x, u in _others(equations, x_hat):
        found = tangent_at(equations, parameters, x, u)
        if found is not None and _tells(found):
            return found
    return first


def _tells(found: LinearPart) -> bool:
    """Return whether each disturbance moves a state and an output shows one."""
    return bool(np.all(np.any(found.G_d, axis=0)) and np.any(found.C))


def require_tangent(equations: Equations, parameters: Vector, x_hat: Vector) -> LinearPart:
    """Return `tangent`. Raises DesignError where the plant has no slopes at x̂₀ (n,)."""
    found = tangent(equations, parameters, x_hat)
    if found is None:
        raise DesignError.report(
            f"{equations.name}, linearised at its start values",
            expected="finite slopes of the derivatives and outputs",
            received="some that cannot be evaluated",
            likely="a root or a quotient of 0; start elsewhere (x0 is 0 where it is not told), or tell the ranges "
            "where the plant works",
        )
    return found


def _others(equations: Equations, x_hat: Vector) -> list[tuple[list[float], list[float]]]:
    """Return points (x, u) across the ranges."""
    ranges, no_input = equations.ranges, (0.0,) * len(equations.inputs)
    if not ranges:
        return []
    return [
        (_across(equations.states, x_hat, ranges, share), _across(equations.inputs, no_input, ranges, share))
        for share in _SHARES
    ]


def _across(names: Sequence[str], otherwise: Vector, ranges: Ranges, share: float) -> list[float]:
    """Return the values a share of the way across each range, and the other values where there is none."""
    found = []
    for name, value in zip(names, otherwise, strict=True):
        if name in ranges:
            low, high = ranges[name]
            found.append(low + share * (high - low))
        else:
            found.append(value)
    return found


def tangent_at(equations: Equations, parameters: Vector, x: Vector, u: Vector) -> LinearPart | None:
    """Return the plant linearised at x (n,) and u (m,), without f; None where it cannot be evaluated there."""
    n, m, q = len(equations.states), len(equations.inputs), len(equations.disturbances)
    d = equations.disturbance_nominal
    try:
        both = np.array(equations.linearisation(x, u, d, parameters), dtype=float).reshape(-1, n + q)
        of_u = np.array(equations.input_slopes(x, u, d, parameters), dtype=float).reshape(len(both), m)
    except (ArithmeticError, ValueError):
        return None
    if not (np.all(np.isfinite(both)) and np.all(np.isfinite(of_u))):
        return None
    return LinearPart(A=both[:n, :n], B=of_u[:n], C=both[n:, :n], G_f=np.zeros((n, 0)), G_d=both[:n, n:], matched=True)


def driven_modes(A: Array, channels: Array) -> ComplexArray:
    """Return the modes (1/s) of the states that the channels (n,·) drive, directly or through other states."""
    driven = np.any(channels != 0.0, axis=1)
    for _ in range(len(A)):
        driven = driven | np.any((A != 0.0) & driven, axis=1)
    block = A[np.ix_(driven, driven)]
    system = balance(block, np.zeros((len(block), 0)), np.zeros((0, len(block))))
    return np.asarray(system.rate * np.linalg.eigvals(system.A)).astype(complex)
