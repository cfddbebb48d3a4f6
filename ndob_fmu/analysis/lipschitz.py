"""The Lipschitz constant γ of eq. (3), measured: the largest slope of f that a search finds where the plant works."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import sympy

from ndob_fmu.analysis.region import samples, working_region
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.progress import begin

_CLIMBS = 8


@dataclass(frozen=True)
class Slope:
    """The largest spectral norm of ∂f/∂x found, and the states and inputs it was found at.

    `value` is infinite if the slope is, or if f cannot be evaluated. `at` has the variables that the slope depends on,
    `searched` says where was looked.
    """

    value: float
    at: Mapping[str, float]
    searched: str


def largest_slope(model: Model, parameters: Mapping[str, float] | None = None) -> Slope:
    """Search the working region for the largest spectral norm of ∂f/∂x.

    Samples with a fixed seed come first, then climbs from the best.

    The samples favour small values, where friction and saturation are steepest. The result is a lower bound of γ: a
    peak that is narrow and far from zero can be missed, and so is a jump between two branches of a Piecewise, which has
    no slope. Raises ModelError for an unknown parameter.
    """
    begin(f"searching for the largest slope of f of {model.name}")
    jacobian = model.vector_field.jacobian
    if jacobian.has(sympy.DiracDelta, sympy.Derivative, sympy.Subs):
        return Slope(np.inf, {}, "everywhere")  # f jumps
    names = [name for name in (*model.states, *model.inputs) if model.symbols[name] in jacobian.free_symbols]
    region = working_region(model)
    low, high = region.bounds(names)
    middle, half_widths = 0.5 * (low + high), 0.5 * (high - low)
    norms = _norms(model, names, model.parameter_values(parameters))
    points = np.vstack([_starts(model, names, low, high), samples(low, high)])
    values = norms(points)
    best = np.argsort(-values, kind="stable")[: _CLIMBS if names and np.isfinite(values).all() else 1]
    found = [(float(values[i]), points[i]) for i in best]
    if np.isfinite(values[best[0]]) and names:
        for _, start in found[:]:
            place, negative = climbed(
                lambda z: -norms((middle + z * half_widths)[None, :])[0],
                np.clip((start - middle) / half_widths, -1.0, 1.0),
                1e-12 * max(1.0, found[0][0]),
            )
            found.append((-negative, middle + place * half_widths))
    value, point = max(found, key=lambda pair: pair[0])
    return Slope(value, dict(zip(names, map(float, point), strict=True)), region.searched(names))


def _starts(model: Model, names: list[str], low: Array, high: Array) -> Array:
    """Return 0, x₀ and x̂₀ with inputs of 0 as points (3, len(names)), the nearest ones in the region."""
    n = len(model.states)
    starts = ((0.0,) * n, model.x0, model.xhat0)
    points = [[start[model.states.index(s)] if s in model.states else 0.0 for s in names] for start in starts]
    return np.asarray(np.clip(np.array(points).reshape(len(starts), -1), low, high))


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
