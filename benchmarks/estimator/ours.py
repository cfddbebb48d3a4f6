"""The observer FMU's slave in this process: the same code as in the built FMU, without the calls through C."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from benchmarks.estimator.plants import Array, Plant
from benchmarks.estimator.records import Record
from fmus.observer_slave import ObserverSlave
from ndob_fmu.codegen.compile_model import compile_model

Estimates = dict[str, Array]
# The outputs of each disturbance, and the name of their column here; the last two exist where `lag` does.
SUFFIXES = {"at": "at_sample", "ahead": "hat", "std": "std", "lagged": "lagged", "lagged_std": "lagged_std"}


class NotAvailableError(Exception):
    """The FMU has no such parameter or output."""


class RefusedError(Exception):
    """The FMU refuses its parameters or a step; the text is what it logs."""


class _Slave(ObserverSlave):
    def __init__(self, plant: Plant) -> None:
        self.messages: list[str] = []
        super().__init__(_equations(plant.name, plant.model), instance_name=plant.name, resources="")

    def log(self, msg: str, status: Any) -> None:
        self.messages.append(msg)


@cache
def _equations(name: str, model: Any) -> Any:
    return compile_model(model())


def parameters_of(plant: Plant, order: int = 2, **others: Any) -> dict[str, Any]:
    """Return the FMU's parameters as a user would set them for the plant; `others` by the FMU's names."""
    model = plant.model()
    told = {f"{y}_noise_std": float(s) for y, s in zip(model.outputs, plant.sigma, strict=True)}
    told |= {f"{x}_hat_start": float(v) for x, v in zip(model.states, plant.x_hat, strict=True)}
    told |= {f"{x}_hat_start_std": float(v) for x, v in zip(model.states, plant.x_std, strict=True)}
    told |= {"method": 2, "disturbance_order": order, "disturbance_bound": plant.bound}
    return told | {"disturbance_rate": plant.rate(order)} | others


def ours(plant: Plant, H: float, U: Array, Y: Array, T: Array | None = None, **fmu_parameters: Any) -> Estimates:
    """Step the observer over one record.

    H: the step (s); T: the steps (K,) where they differ
    U (K,m), Y (K,p): inputs and samples
    fmu_parameters: by the FMU's names, instead of those of `parameters_of`; `disturbance_order` changes the rate too

    Returns at, ahead, std (K,q), valid (K,), residual, residual_std (K,p), x_hat (K,n), and lagged, lagged_std (K,q)
    and consistency (K,) where the FMU has them.
    Raises NotAvailableError for a parameter that the FMU has not, RefusedError where it logs an error.
    """
    slave, model = _Slave(plant), plant.model()
    order = int(fmu_parameters.get("disturbance_order", 2))
    set_parameters(slave, parameters_of(plant, order) | fmu_parameters)
    names = [v.name for v in slave.variables.declared if v.causality == "output"]
    steps = np.full(len(Y), H) if T is None else T
    slave.setup_experiment(0.0, None, None)
    slave.enter_initialization_mode()
    present, inputs = slave.variables.present, slave.variables.stretch([*model.inputs, *model.outputs])
    present[inputs] = [*U[0], *Y[0]]
    slave.exit_initialization_mode()
    rows = np.empty((len(Y), len(names)))
    t = 0.0
    for k, H_k in enumerate(steps.tolist()):
        present = slave.variables.present
        present[inputs] = [*U[k].tolist(), *Y[k].tolist()]
        if not slave.do_step(t, H_k):
            raise RefusedError(slave.messages[-1] if slave.messages else "a step without a message")
        rows[k] = slave.variables.present[slave.variables.outputs]
        t += H_k

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
    if "consistency" in names:
        found["consistency"] = columns(["consistency"])[:, 0]
    return found


def ours_of(record: Record, **fmu_parameters: Any) -> Estimates:
    """Run `ours` over all records and return its arrays with the record as first axis."""
    U, Y = record.U, record.Y
    runs = [ours(record.plant, record.H, u, y, record.steps, **fmu_parameters) for u, y in zip(U, Y, strict=True)]
    return {key: np.stack([run[key] for run in runs]) for key in runs[0]}


def set_parameters(slave: _Slave, values: dict[str, Any]) -> None:
    """Set parameters by their names. Raises NotAvailableError for one that the FMU has not."""
    types = {v.name: (reference, v.type) for reference, v in enumerate(slave.variables.declared)}
    noise = {name: value for name, value in values.items() if name.endswith("_noise_std") and name not in types}
    if noise and "noise_std" in types and len(set(noise.values())) == 1:
        values = {name: value for name, value in values.items() if name not in noise}
        values["noise_std"] = next(iter(noise.values()))
    for name, value in values.items():
        if name not in types:
            raise NotAvailableError(name)
        reference, kind = types[name]
        if kind == "Real":
            slave.set_real([reference], [float(value)])
        elif kind == "Boolean":
            slave.set_boolean([reference], [bool(value)])
        else:
            slave.set_integer([reference], [int(value)])
    if slave.messages:
        raise RefusedError(slave.messages[-1])
