"""The Lipschitz constant γ of eq. (3), measured: the largest slope of f that a search over a box finds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import sympy

from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.progress import begin

SMALLEST_BOX = 10.0
_START_VALUES_REACH = 10.0
_SAMPLES = 4096
_CLIMBS = 8
_SMALLEST_MAGNITUDE = 1e-8


@dataclass(frozen=True)
class Slope:
    """The largest spectral norm of ∂f/∂x found, and the states and inputs it was found at.

    `value` is infinite if the slope is, or if f cannot be evaluated. `at` has the variables that the slope depends on.
    """

    value: float
    at: Mapping[str, float]


def box(model: Model) -> dict[str, float]:
    """Return the half-width of the search per state and input: 10, or ten times the start value if that is more."""
    states = {
        name: max(SMALLEST_BOX, _START_VALUES_REACH * abs(x0), _START_VALUES_REACH * abs(xhat0))
        for name, x0, xhat0 in zip(model.states, model.x0 or (), model.xhat0 or (), strict=True)
    }
    return states | dict.fromkeys(model.inputs, max(states.values()))


def largest_slope(model: Model, parameters: Mapping[str, float] | None = None) -> Slope:
    """Search the box for the largest spectral norm of ∂f/∂x: samples with a fixed seed, then climbs from the best.

    The samples favour small values, where friction and saturation are steepest. The result is a lower bound of γ: a
    peak that is narrow and far from zero can be missed, and so is a jump between two branches of a Piecewise, which has
    no slope. Raises ModelError for an unknown parameter.
    """
    begin(f"searching for the largest slope of f of {model.name}")
    jacobian = model.vector_field.jacobian
    if jacobian.has(sympy.DiracDelta, sympy.Derivative, sympy.Subs):
        return Slope(np.inf, {})  # f jumps
    names = [name for name in (*model.states, *model.inputs) if model.symbols[name] in jacobian.free_symbols]
    half_widths = np.array([box(model)[name] for name in names])
    norms = _norms(model, names, model.parameter_values(parameters))
    starts = np.array([[v[model.states.index(s)] if s in model.states else 0.0 for s in names] for v in _starts(model)])
    points = np.vstack([starts, samples(half_widths)])
    values = norms(points)
    best = np.argsort(-values, kind="stable")[: _CLIMBS if names and np.isfinite(values).all() else 1]
    found = [(float(values[i]), points[i]) for i in best]
    if np.isfinite(values[best[0]]) and names:
        for _, start in found[:]:
            place, negative = climbed(
                lambda z: -norms((z * half_widths)[None, :])[0], start / half_widths, 1e-12 * max(1.0, found[0][0])
            )
            found.append((-negative, place * half_widths))
    value, point = max(found, key=lambda pair: pair[0])
    return Slope(value, dict(zip(names, map(float, point), strict=True)))


def _starts(model: Model) -> tuple[tuple[float, ...], ...]:
    n = len(model.states)
    return ((0.0,) * n, tuple(model.x0 or ()), tuple(model.xhat0 or ()))


def climbed(cost: Callable[[Array], float], start: Array, tolerance: float) -> tuple[Array, float]:
    """Return the place (k,) in the box [−1, 1]ᵏ and the cost at which a search from `start` (k,) finds it least.

    tolerance: of the cost, absolute.
    """
    import scipy.optimize  # only here: a linear plant needs no search, and the import takes longer than all its checks

    found = scipy.optimize.minimize(
        cost,
        start,
        method="Nelder-Mead",
        bounds=[(-1.0, 1.0)] * len(start),
        options={"xatol": 1e-9, "fatol": tolerance, "maxiter": 200 * len(start)},
    )
    return found.x, float(found.fun)


def samples(half_widths: Array) -> Array:
    """Return points (4096, len(half_widths)) of the box, with a fixed seed; half of their entries are small."""
    random = np.random.default_rng(0)
    shape = (_SAMPLES, len(half_widths))
    points = random.uniform(-1.0, 1.0, shape)
    small = random.random(shape) < 0.5
    points[small] *= _SMALLEST_MAGNITUDE ** random.random(int(np.sum(small)))
    return np.asarray(points * half_widths)


def _norms(model: Model, names: list[str], parameters: tuple[float, ...]) -> Callable[[Array], Array]:
    """Return the function that maps points (N, len(names)) to spectral norms (N,), infinite where not defined."""
    values = dict(zip((model.symbols[name] for name in model.parameters), parameters, strict=True))
    jacobian = model.vector_field.jacobian
    entries = sympy.lambdify(
        [[model.symbols[name] for name in names], list(values)], list(jacobian), modules="numpy", dummify=True
    )

    def norms(points: Array) -> Array:
        with np.errstate(all="ignore"):
            columns = [np.asarray(entry) for entry in entries(list(points.T), list(values.values()))]
        stacked = np.stack([np.broadcast_to(column, (len(points),)) for column in columns], axis=-1)
        if np.iscomplexobj(stacked):
            stacked = np.where(stacked.imag == 0, stacked.real, np.nan)
        defined = np.isfinite(stacked).all(axis=-1)
        matrices = np.where(defined[:, None], stacked, 0.0).reshape(-1, *jacobian.shape)
        return np.where(defined, np.linalg.norm(matrices, 2, axis=(1, 2)), np.inf)

    return norms
