"""The direction n(x, u) of a state-dependent disturbance channel, searched for where it vanishes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import sympy

from ndob_fmu.analysis.lipschitz import climbed
from ndob_fmu.analysis.region import samples, working_region
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.progress import begin

_CLIMBS = 8


@dataclass(frozen=True)
class Shortest:
    """The least ‖[n₁/n̄₁ … n_k/n̄_k]‖ found, and the states and inputs it was found at.

    `length` is 0 if n cannot be evaluated. `largest_entry`: the largest |n_j|/n̄_j found; above 1 a bound is wrong,
    or the search has left the plant's range.
    """

    length: float
    at: Mapping[str, float]
    largest_entry: float


def shortest_direction(model: Model, parameters: Mapping[str, float] | None = None) -> Shortest:
    """Search the working region for the shortest n: samples with a fixed seed, then climbs from the best.

    The result is an upper bound of the least length. Raises ModelError for an unknown parameter.
    """
    begin(f"searching for the shortest direction n of {model.name}")
    expressions = sympy.Matrix(model.channel_expressions)
    names = [name for name in (*model.states, *model.inputs) if model.symbols[name] in expressions.free_symbols]
    values = dict(
        zip((model.symbols[name] for name in model.parameters), model.parameter_values(parameters), strict=True)
    )
    entries = sympy.lambdify(
        [[model.symbols[name] for name in names], list(values)], list(expressions), modules="numpy", dummify=True
    )
    bound = np.array(model.channel_bound, dtype=float)

    def shares(points: Array) -> Array:
        """Return |n_j|/n̄_j (N,k) at points (N, len(names)), 0 where one is not a real number."""
        with np.errstate(all="ignore"):
            columns = [np.asarray(entry) for entry in entries(list(points.T), list(values.values()))]
        stacked = np.stack([np.broadcast_to(column, (len(points),)) for column in columns], axis=-1)
        defined = np.isfinite(stacked).all(axis=-1) & (np.imag(stacked) == 0).all(axis=-1)
        return np.asarray(np.where(defined[:, None], np.abs(stacked), 0.0) / bound)

    low, high = working_region(model).bounds(names)
    middle, half_widths = 0.5 * (low + high), 0.5 * (high - low)
    points = samples(low, high) if names else np.zeros((1, 0))
    found = shares(points)
    lengths = np.linalg.norm(found, axis=1)
    best, length = points[int(np.argmin(lengths))], float(np.min(lengths))
    for start in points[np.argsort(lengths, kind="stable")[: _CLIMBS if names and length else 0]]:
        place, least = climbed(
            lambda z: float(np.linalg.norm(shares((middle + z * half_widths)[None]))),
            np.clip((start - middle) / half_widths, -1.0, 1.0),
            1e-12,
        )
        if least < length:
            best, length = middle + place * half_widths, least
    return Shortest(length, dict(zip(names, map(float, best), strict=True)), float(np.max(found)))
