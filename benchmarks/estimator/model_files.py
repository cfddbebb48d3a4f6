"""Rows of any model files: how the observer fares beside an extended Kalman filter with the same information.

The file says all that both are told: noise, bounds and rates of the disturbances, what is known of the start, step and
stop time. The record's disturbances are sines of half the bound at the declared pace, and its inputs stay in the middle
of their ranges, at 0 without ranges. A file may say otherwise, for single numbers and lists:

    def control(t, y): …       the inputs (m,), held over the step from t (s) on, for a sample y (p,)
    def disturbance(t): …      the disturbances (q,)

The filter is tuned on other records: it gets the intensity with the least error for sines at the whole bound and the
declared pace. A second row gives it the intensity that ours works with.
"""

from __future__ import annotations

import runpy
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import inf, isfinite, pi
from typing import Any

import numpy as np
import sympy

from benchmarks.estimator.figures import Figure
from benchmarks.estimator.kalman import ekf
from benchmarks.estimator.ours import NotAvailableError, RefusedError, ours_of, published_intensity
from benchmarks.estimator.plants import Array, Control, Plant
from benchmarks.estimator.records import Disturbance, simulate
from benchmarks.estimator.scores import score
from benchmarks.estimator.tasks import Seeds, ms
from benchmarks.estimator.textbook import slope_of
from ndob_fmu import Model, load_model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import ModelError
from ndob_fmu.runtime.design.operating_point import middle_input

_LIMIT = 1.15  # times the error of the filter
_ORDER = 2
# The truth's substep is halved until samples change by less than this part of their noise; the filter's is four times
# the truth's.
_EXACT, _COARSER, _MOST = 1e-2, 4, 2**12


def beside_the_filter(seeds: Seeds, path: str) -> list[Figure]:
    """Judge the error at the sample, the error bars and `valid` of the model of a file."""
    plant, disturbance = plant_of_file(path)
    H = float(plant.model().experiment.step_size)
    text = f"{plant.name}, {ms(H)}"
    record = simulate(plant, H, seeds, disturbance)
    try:
        found = score(record, ours_of(record))
        same = score(record, ekf(record, intensity=published_intensity(plant, H))).rms
    except (NotAvailableError, RefusedError) as error:
        return [Figure(text, float("nan"), None, note=str(error))]
    tuned = score(record, ekf(record)).rms
    return [
        _of_filter(f"{text}: {_LIMIT} × EKF, tuned on sines at the bound", tuned, found.rms),
        _of_filter(f"{text}: {_LIMIT} × EKF with our intensity", same, found.rms),
        Figure(f"{text}: share within 2·std", 0.90, found.covered, at_least=True),
        Figure(f"{text}: share with `valid` true", 1.0, found.valid, at_least=True),
    ]


def _of_filter(text: str, of_filter: float, found: float) -> Figure:
    if isfinite(of_filter):
        return Figure(text, _LIMIT * of_filter, found)
    return Figure(f"{text} (which diverges)", inf, found)


@cache
def plant_of_file(path: str) -> tuple[Plant, Disturbance | None]:
    """Return the plant of a model file, and d(t) where the file says so."""
    model, defined = load_model(path), runpy.run_path(path)
    rates, bounds = np.array(compile_model(model).disturbance_rate), np.array(model.disturbance_bound)
    order = model.observer.disturbance_order
    paces = (rates / bounds) ** (1.0 / max(order, 1)) / (2.0 * pi)
    if order != _ORDER or not np.allclose(paces, paces[0], rtol=1e-6):
        raise ModelError.report(
            f"{path}, observer",
            expected=f"disturbance_order {_ORDER}, and rates D₀ (2π f)² with one f for all disturbances",
            received=f"order {order} and f = {paces} Hz",
        )
    plant = Plant(
        name=model.name,
        model=lambda: model,
        parameters=dict(model.parameters),
        slope=slope_of(model),
        control=_control(model, defined.get("control")),
        C=_outputs(model),
        x0=np.array(model.x0),
        x_hat=np.array(model.xhat0),
        x_std=np.array(model.xhat0_std),
        sigma=np.array(model.told("noise_std")),
        bound=bounds,
        substep=model.experiment.step_size,
        stop_time=model.experiment.stop_time,
        pace=float(paces[0]),
        nominal=np.array(model.disturbance_nominal),
    )
    return _with_short_substep(plant, defined.get("disturbance")), defined.get("disturbance")


def _control(model: Model, control: Callable[[float, Any], Any] | None) -> Control:
    if control is None:
        middle = np.array(middle_input(model.inputs, model.ranges))
        return lambda t, y, memory, H: np.tile(middle, (len(y), 1))
    return lambda t, y, memory, H: np.array([np.atleast_1d(control(t, row)) for row in y], dtype=float)


def _outputs(model: Model) -> Array:
    """Return C (p,n). Raises ModelError where an output is not linear in the states alone."""
    x = [model.symbols[name] for name in model.states]
    values = {model.symbols[name]: value for name, value in model.parameters.items()}
    outputs = sympy.Matrix(model.vector_field.outputs).subs(values)
    slopes = outputs.jacobian(x)
    if slopes.free_symbols or any((outputs - slopes * sympy.Matrix(x)).expand()):
        raise ModelError.report(
            f"{model.name}.outputs",
            expected="states, or sums of them, for the comparison with a Kalman filter",
            received=", ".join(map(str, model.vector_field.outputs)),
        )
    return np.array(slopes.tolist(), dtype=float)


def _with_short_substep(plant: Plant, disturbance: Disturbance | None) -> Plant:
    """Return the plant with a substep that the filter's integration is exact with. Raises ModelError without one."""
    H, before = plant.substep, None
    parts = 1
    while parts <= _MOST:
        tried = replace(plant, substep=H / (2 * parts))
        try:
            with np.errstate(all="ignore"):
                Y = simulate(tried, H, [0], disturbance).Y
        except ValueError:  # the steps are too long for the plant's fastest mode
            Y = None
        if Y is not None and before is not None and np.max(np.abs(Y - before) / plant.sigma) <= _EXACT:
            return replace(plant, substep=H / (_COARSER * parts))
        parts, before = 2 * parts, Y
    raise ModelError.report(
        plant.name,
        expected=f"a motion that substeps of H/{_MOST} follow",
        received="one that diverges or that changes with the substep",
        likely="a plant that needs a controller: define control(t, y) in the file",
    )
