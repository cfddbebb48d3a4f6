"""A plant of the benchmark from a model file that has its equations as in a textbook.

The truth, and the filters that we compare with, evaluate the equations as they stand in the file, by NumPy. They use
nothing of how this package takes the equations apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy

from benchmarks.estimator.plants import Array, Control, Parameters, Plant, Slope
from ndob_fmu import Model, load_model

EXAMPLES = Path(__file__).parents[2] / "examples"


def textbook_plant(
    name: str, control: Control, *, pace: float, substep: float, resolution: dict[str, float] | None = None
) -> Plant:
    """Return the plant of `examples/<name>.py`, with all that the model says of it.

    pace: Hz, of the disturbances, as the model declares them
    resolution: of the outputs that are rounded; their `noise_std` is that of the rounding
    """
    model = _loaded(name)
    outputs, states = tuple(model.outputs), tuple(model.states)
    rounded = [(resolution or {}).get(y, 0.0) for y in outputs]
    plant = Plant(
        name=name,
        model=lambda: model,
        parameters=dict(model.parameters),
        slope=slope_of(model),
        control=control,
        C=np.eye(len(states))[[states.index(y) for y in outputs]],
        x0=np.array(model.x0),
        x_hat=np.array(model.xhat0),
        x_std=np.array(model.xhat0_std),
        sigma=np.array(model.told("noise_std")),
        bound=np.array(model.disturbance_bound),
        substep=substep,
        stop_time=model.experiment.stop_time,
        pace=pace,
        nominal=np.array(model.disturbance_nominal),
        resolution=np.array(rounded) if any(rounded) else None,
    )
    declared = np.atleast_1d(model.observer.disturbance_rate) / plant.bounds
    if not np.allclose(declared, (2.0 * pi * pace) ** 2, rtol=1e-9):
        raise ValueError(f"{name}: expected disturbance_rate = D₀ (2π {pace:g})², received {declared} D₀")
    return plant


def slope_of(model: Model) -> Slope:
    """Return ẋ (…,n) of x (…,n), u (…,m), d (…,q) and the parameters, from the equations as they stand in the file."""
    groups = (model.states, model.inputs, model.disturbances, model.parameters)
    symbols = [model.symbols[name] for group in groups for name in group]
    rows = [_without_extremes(sympy.sympify(row)) for row in _rows(model, groups)]
    derivatives = sympy.lambdify(symbols, rows, [_EXTREMES, "numpy"], cse=True)

    def slope(x: Any, u: Any, d: Any, p: Parameters) -> Any:
        columns = [values[..., i] for values in (x, u, d) for i in range(values.shape[-1])]
        values = derivatives(*columns, *(p[name] for name in model.parameters))
        return np.stack(np.broadcast_arrays(*values), axis=-1)

    return slope


def _rows(model: Model, groups: Sequence[Sequence[str]]) -> list[Any]:
    """Return ẋ (n,) in the model's symbols, from `dynamics`, or from the matrices and f."""
    spaces = [SimpleNamespace(**{name: model.symbols[name] for name in group}) for group in groups]
    if model.dynamics is not None:
        return list(model.dynamics(*spaces))
    x, u, d = (sympy.Matrix(len(group), 1, [model.symbols[name] for name in group]) for group in groups[:3])
    f = [] if model.f is None else list(model.f(spaces[0], spaces[1], spaces[3]))
    total = model.A * x + model.G_d * d
    if u:
        total += model.B * u
    if f:
        total += model.G_f * sympy.Matrix(f)
    return list(total)


# NumPy's printer takes the extremes of numbers and arrays apart wrongly; these also take complex steps.
_EXTREMES = {
    "largest": lambda *values: reduce(np.maximum, values),
    "smallest": lambda *values: reduce(np.minimum, values),
}


def _without_extremes(row: sympy.Expr) -> sympy.Expr:
    largest, smallest = map(sympy.Function, _EXTREMES)
    return row.replace(sympy.Max, lambda *a: largest(*a)).replace(sympy.Min, lambda *a: smallest(*a))


@cache
def _loaded(name: str) -> Model:
    return load_model(str(EXAMPLES / f"{name}.py"))


def filtered_rate(now: Array, memory: dict[str, Array], name: str, H: float, time_constant: float) -> Array:
    """Return the filtered rate of a sampled signal for a controller, from its last sample and rate in `memory`."""
    before = memory.get(name, now)
    rate = memory.get(f"{name} rate", np.zeros_like(now))
    rate = rate + min(1.0, H / time_constant) * ((now - before) / H - rate)
    memory.update({name: now, f"{name} rate": rate})
    return rate
