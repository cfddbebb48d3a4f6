"""The observer FMU's slave in this process: the same code as in the built FMU, without the calls through C."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from pythonfmu.enums import Fmi2Status

from benchmarks.estimator.plants import Array, Plant
from benchmarks.estimator.records import Record
from fmus.observer_slave import ObserverSlave
from fmus.plant_slave import PlantSlave
from fmus.slave_base import Slave
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.interface.model_variables import for_each_disturbance
from ndob_fmu.runtime.equations import Equations

Estimates = dict[str, Array]
# The outputs of each disturbance, and the name of their column here; the last two exist where `lag` does.
SUFFIXES = {"at": "at_sample", "ahead": "hat", "std": "std", "lagged": "lagged", "lagged_std": "lagged_std"}


class NotAvailableError(Exception):
    """The FMU has no such parameter or output."""


class RefusedError(Exception):
    """The FMU refuses its parameters or a step; the text is what it logs."""


class _Quiet(Slave):
    """A slave in this process; what it logs is kept, but for warnings."""

    messages: list[str]
    seconds: Array

    def __init__(self, equations: Equations) -> None:
        self.messages = []
        super().__init__(equations, instance_name="benchmark", resources="")  # type: ignore[arg-type]

    def log(self, msg: str, status: Fmi2Status) -> None:
        if status not in (Fmi2Status.ok, Fmi2Status.warning):
            self.messages.append(msg)

    def begin(self, values: dict[str, Any]) -> None:
        """Set parameters and inputs and go through the initialization."""
        types = {v.name: (reference, v.type) for reference, v in enumerate(self.variables.declared)}
        self.setup_experiment(0.0, None, None)
        self.enter_initialization_mode()
        for name, value in values.items():
            if name not in types:
                raise NotAvailableError(name)
            reference, kind = types[name]
            if kind == "Real":
                self.set_real([reference], [float(value)])
            elif kind == "Boolean":
                self.set_boolean([reference], [bool(value)])
            else:
                self.set_integer([reference], [int(value)])
        self.exit_initialization_mode()
        if self.messages:
            raise RefusedError(self.messages[-1])

    def run(self, rows: Array, names: Sequence[str], steps: Array) -> Array:
        """Step with a row (K,len(names)) of inputs each and return the outputs (K,…) at the ends of the steps (K,).

        `seconds` then has the processor's time of each step, which other programs hardly change.
        """
        at = self.variables.stretch(names)
        found = np.empty((len(rows), len(self.variables.present[self.variables.outputs])))
        self.seconds = np.empty(len(rows))
        t = 0.0
        for k, H in enumerate(steps.tolist()):
            begin = time.process_time()
            self.variables.present[at] = rows[k].tolist()
            if not self.do_step(t, H):
                raise RefusedError(self.messages[-1] if self.messages else "a step without a message")
            found[k] = self.variables.present[self.variables.outputs]
            t += H
            self.seconds[k] = time.process_time() - begin
        return found


class _QuietObserver(_Quiet, ObserverSlave):
    pass


class _QuietPlant(_Quiet, PlantSlave):
    pass


@cache
def _equations(plant: Plant) -> Equations:
    return compile_model(plant.model())


def parameters_of(plant: Plant, **others: Any) -> dict[str, Any]:
    """Return the FMU's parameters as a user would set them for the plant, with `others` in place of theirs."""
    model = plant.model()
    told = {f"{y}_noise_std": float(s) for y, s in zip(model.outputs, plant.sigma, strict=True)}
    told |= {f"{x}_hat_start": float(v) for x, v in zip(model.states, plant.x_hat, strict=True)}
    told |= {f"{x}_hat_start_std": float(v) for x, v in zip(model.states, plant.x_std, strict=True)}
    order = int(others.get("disturbance_order", 2))
    told |= {"method": 2, "disturbance_order": order}
    for label, values in {"disturbance_bound": plant.bounds, "disturbance_rate": plant.rates(order)}.items():
        names = for_each_disturbance(label, tuple(model.disturbances)).values()
        told |= dict(zip(names, values.tolist(), strict=True))
    return told | others


def ours(plant: Plant, H: float, U: Array, Y: Array, T: Array | None = None, **fmu_parameters: Any) -> Estimates:
    """Step the observer over one record.

    H: the step (s); T: the steps (K,) where they differ
    U (K,m), Y (K,p): inputs and samples
    fmu_parameters: by the FMU's names, in place of the usual ones; `disturbance_order` changes the rate too

    Returns at, ahead, std (K,q), valid (K,), residual, residual_std (K,p), x_hat (K,n), seconds (K,) of each step, and
    lagged, lagged_std (K,q) and consistency (K,) where the FMU has them.
    Raises NotAvailableError for a parameter that the FMU has not, RefusedError where it logs an error.
    """
    slave, model = _QuietObserver(_equations(plant)), plant.model()
    slave.begin(parameters_of(plant, **fmu_parameters) | dict(zip(model.outputs, Y[0].tolist(), strict=True)))
    names = [v.name for v in slave.variables.declared if v.causality == "output"]
    steps = np.full(len(Y), H) if T is None else T
    rows = slave.run(np.hstack([U, Y]), [*model.inputs, *model.outputs], steps)

    def columns(wanted: list[str]) -> Array:
        return rows[:, [names.index(name) for name in wanted]]

    found = {
        key: columns([f"{d}_{suffix}" for d in model.disturbances])
        for key, suffix in SUFFIXES.items()
        if f"{model.disturbances[0]}_{suffix}" in names
    }
    found["x_hat"] = columns([f"{x}_hat" for x in model.states])
    found["residual"] = columns([f"{y}_residual" for y in model.outputs])
    found["residual_std"] = columns([f"{y}_residual_std" for y in model.outputs])
    found["valid"] = columns(["valid"])[:, 0] == 1.0
    found["seconds"] = slave.seconds
    if "consistency" in names:
        found["consistency"] = columns(["consistency"])[:, 0]
    return found


def ours_of(record: Record, **fmu_parameters: Any) -> Estimates:
    """Run `ours` over all records and return its arrays with the record as first axis."""
    U, Y = record.U, record.Y
    runs = [ours(record.plant, record.H, u, y, record.steps, **fmu_parameters) for u, y in zip(U, Y, strict=True)]
    return {key: np.stack([run[key] for run in runs]) for key in runs[0]}


def published_intensity(plant: Plant, H: float, order: int = 2, **fmu_parameters: Any) -> float:
    """Return the intensity of the white noise behind d^{(r)} that ours works with at the step H (s)."""
    slave = _QuietObserver(_equations(plant))
    slave.begin(parameters_of(plant, disturbance_order=order, **fmu_parameters))
    return float(slave.observer.tuned(H).intensities.disturbance[0])  # type: ignore[attr-defined]


def plant_run(plant: Plant, H: float, U: Array) -> tuple[Array, Array]:
    """Step the plant FMU's slave without disturbance.

    Returns its states (K,n) at the ends of the steps, and the processor's time of each step (K,), in s.
    """
    slave, model = _QuietPlant(_equations(plant)), plant.model()
    slave.begin({f"{x}_start": float(value) for x, value in zip(model.states, plant.x0, strict=True)})
    names = [v.name for v in slave.variables.declared if v.causality == "output"]
    rows = slave.run(U, list(model.inputs), np.full(len(U), H))
    return rows[:, [names.index(x) for x in model.states]], slave.seconds
