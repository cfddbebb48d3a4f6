"""The folder of a run: signals, summary and figures, for people and for `ndob-fmu report`."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ndob_fmu.cosim.component import Value
from ndob_fmu.cosim.simulation import open_system, simulate
from ndob_fmu.cosim.system.inputs import read_inputs
from ndob_fmu.cosim.system.picture import write_picture
from ndob_fmu.cosim.system.ports import Port
from ndob_fmu.cosim.system.system import System
from ndob_fmu.cosim.values import convert
from ndob_fmu.results import plots
from ndob_fmu.results.recording import FailedRunError, Recording
from ndob_fmu.results.run_files import SYSTEM_PICTURE, write_run
from ndob_fmu.results.versions import software_versions
from ndob_fmu.support.files import atomic_folder


def simulate_into(folder: Path, system: str | Path, **settings: Any) -> Recording:
    """Simulate, write result.csv, summary.json, signals and system into ``folder``, and return the recording.

    All files are written or none. settings: those of `simulate`, whose errors are passed on. After a failure the rows
    before it are written first. Raises UsageError if a file cannot be written.
    """
    began = time.perf_counter()
    failure: FailedRunError | None = None
    try:
        recording = simulate(system, **settings)
    except FailedRunError as error:
        if error.recording is None:
            raise
        recording, failure = error.recording, error
    wall_time = time.perf_counter() - began
    summary = summary_of(system, recording, settings)
    how = {"failed": failure and str(failure), "scheme": settings.get("scheme", "jacobi"), "wall_time": wall_time}
    with atomic_folder(folder) as new:
        inputs = None if settings.get("input_file") is None else _inputs(system, recording, settings)
        write_run(new, recording, {**summary, **how}, inputs)
        plots.plot_signals(new / "signals.png", recording)
        write_system_picture(new, system)
    if failure is not None:
        raise failure
    return recording


def _inputs(system: System | str | Path, recording: Recording, settings: Mapping[str, Any]) -> Recording:
    """Return what the inputs from the file had at each row of the recording."""
    with open_system(system, settings.get("step_size")) as (opened, _):
        table = read_inputs(settings["input_file"], opened)
    # A row of the file holds from its time on, which the file's decimals may miss by their rounding.
    slack = 1e-6 * float(np.ptp(recording.time[:2]))
    rows = np.searchsorted(table.time, recording.time + slack, side="right") - 1
    return Recording(recording.time, tuple(map(str, table.ports)), table.values[rows])


def write_system_picture(folder: Path, system: System | str | Path) -> None:
    """Write the picture of a system into a folder of results, where the report finds it."""
    with open_system(system) as (opened, _):
        write_picture(folder / SYSTEM_PICTURE, opened, "" if isinstance(system, System) else Path(system).name)


def summary_of(system: System | str | Path, recording: Recording, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of summary.json on how these settings of `simulate` made a recording.

    output_interval: only where rows are further apart than steps. connections: input → [output, factor, offset].
    step_ratios, order: only where there are any. parameters: ``component.variable`` → value of every parameter, and of
    every other variable that a start value was given for. units: of signals, inputs and parameters that have one.
    stop_time: of the last row. ended_early: what ended the run before its stop time, None if nothing did.
    """
    regular = len(recording.time) - bool(recording.ended_early)  # the row of an early end lies between others
    interval = float(recording.time[1] - recording.time[0]) if regular > 1 else None
    with open_system(system, settings.get("step_size")) as (opened, experiment):
        parameters = _parameters(opened, settings.get("start_values") or {})
        connections = {str(c.target): [str(c.source), c.factor, c.offset] for c in opened.connections}
        units = {
            f"{name}.{variable.name}": variable.unit
            for name, component in opened.components.items()
            for variable in component.variables
            if variable.causality == "input" or f"{name}.{variable.name}" in parameters
        }
        step = settings.get("step_size") or experiment.step_size or interval
        order = settings.get("order") or opened.components
        coupling = {
            "output_interval": interval if interval and not math.isclose(step or 0.0, interval, rel_tol=1e-6) else None,
            "order": list(order) if settings.get("scheme") == "gauss-seidel" else None,
            "step_ratios": dict(opened.step_ratios),
        }
    return {
        "system": "" if isinstance(system, System) else Path(system).name,
        "step_size": step,
        "stop_time": float(recording.time[-1]),
        "ended_early": recording.ended_early or None,
        **{name: value for name, value in coupling.items() if value},
        "connections": connections,
        "parameters": parameters,
        "units": {**recording.units, **{name: unit for name, unit in units.items() if unit}},
        "versions": software_versions(),
    }


def _parameters(system: System, given: Mapping[str, Value]) -> dict[str, Value]:
    starts = dict(system.start_values)
    for name, value in given.items():
        starts |= system.starts(name, value)
    values: dict[str, Value] = {}
    for name, component in system.components.items():
        for variable in component.variables:
            default = variable.start if variable.causality == "parameter" else None
            found = starts.get(Port(name, variable.name), default)
            if found is not None:
                value = convert(variable, found, variable.name)
                items = {number: item for item, number in variable.items}
                values[f"{name}.{variable.name}"] = items.get(value, value) if isinstance(value, int) else value
    return values
