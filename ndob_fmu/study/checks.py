"""Checks of a study file against its system: names, times and coupling."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from ndob_fmu.cosim import System, Value
from ndob_fmu.cosim.component import recordable
from ndob_fmu.cosim.default_experiment import DefaultExperiment
from ndob_fmu.cosim.simulation import warn
from ndob_fmu.cosim.system.inputs import NO_INPUTS, read_inputs
from ndob_fmu.cosim.system.ports import Port
from ndob_fmu.cosim.system.wiring import wire
from ndob_fmu.cosim.time_grid import TimeGrid
from ndob_fmu.cosim.values import convert
from ndob_fmu.errors import CouplingError, NdobError, UsageError
from ndob_fmu.study.points import Points
from ndob_fmu.study.study import STEP_SIZE, Simulation
from ndob_fmu.study.toml_file import TomlTable


def check_names(file: TomlTable, system: System, points: Points, fixed: Mapping[str, Value]) -> None:
    """Raise UsageError or CouplingError unless each name can be set and takes all of its values."""
    levels = {name: [value] for name, value in fixed.items()} | points.levels()
    set_by: dict[Port, str] = {}
    for name, values in levels.items():
        if name == STEP_SIZE:
            wrong = [v for v in values if isinstance(v, bool | str) or not v > 0]
            if wrong:
                raise UsageError.report(f"{file.where}, {name}", expected="positive numbers", received=repr(wrong[0]))
            continue
        with _located(file.where):
            first = system.starts(name, values[0])
            for port in first:
                if port in set_by:
                    raise UsageError.report(
                        str(port), expected="one name that sets it", received=f"{set_by[port]!r} and {name!r}"
                    )
                set_by[port] = name
            replace(system, start_values={**system.start_values, **first})
            for value in values:
                for port in first:
                    convert(system.variable(port), value, name)


def check_times(
    file: TomlTable, experiment: DefaultExperiment, simulation: Simulation, points: Points
) -> tuple[list[float], float]:
    """Return the step sizes of the study and the least time of a last row (s).

    Raises UsageError unless each step size fits into the times.
    """
    start, stop = (
        default if given is None else given
        for given, default in (
            (simulation.start_time, experiment.start_time),
            (simulation.stop_time, experiment.stop_time),
        )
    )
    default = experiment.step_size if simulation.step_size is None else simulation.step_size
    steps = [float(step) for step in points.levels().get(STEP_SIZE, [] if default is None else [default])]
    if stop is None or not steps:
        received = "none, and the system has no default"
        raise UsageError.report(f"{file.where}, [simulation]", expected="stop_time and step_size", received=received)
    with _located(f"{file.where}, [simulation]"):
        grids = [TimeGrid.over(start or 0.0, stop, step, simulation.output_interval) for step in steps]
    return steps, min(grid.time(grid.steps - grid.steps % grid.stride) for grid in grids)


def check_coupling(
    file: TomlTable, system: System, simulation: Simulation, points: Points, fixed: Mapping[str, Value]
) -> None:
    """Raise UsageError or CouplingError unless the system can be wired as the study says."""
    with _located(f"{file.where}, [simulation]"):
        starts: dict[Port, Value] = {}
        for name, value in {**fixed, **points[0]}.items():
            starts |= {} if name == STEP_SIZE else system.starts(name, value)
        table = NO_INPUTS if simulation.input_file is None else read_inputs(simulation.input_file, system)
        if simulation.order is not None and simulation.scheme != "gauss-seidel":
            raise UsageError.report("order", expected="scheme = 'gauss-seidel'", received=repr(simulation.scheme))
        wiring = wire(system, table, starts, simulation.order, strict=simulation.strict)
    warn(wiring)  # once for the study


def resolver(where: str, system: System) -> Callable[[str, Any], str]:
    """Return a function of (entry of the file, name) that gives the full name of an output, or raises."""
    known = outputs(system)

    def resolve(entry: str, name: Any) -> str:
        if not isinstance(name, str):
            raise UsageError.report(f"{where}, {entry}", expected="the name of a signal", received=repr(name))
        if name in system.outputs:
            return name
        with _located(f"{where}, {entry}"):
            full = str(system.port(name))
        if full not in known:
            received = f"{full}, which is not one"
            raise CouplingError.report(f"{where}, {entry}", expected="a numeric output", received=received)
        return full

    return resolve


def unit_of_name(system: System, name: str) -> str | None:
    """Return the unit that the FMU declares for the variable of a name."""
    if name in system.outputs:
        return system.variable(system.outputs[name].port).unit
    if name in system.inputs:
        return next((system.variable(link.port).unit for link in system.inputs[name]), None)
    return system.variable(system.port(name)).unit


def outputs(system: System) -> list[str]:
    """Return the names of the signals that a run records."""
    own = [f"{name}.{v.name}" for name, component in system.components.items() for v in recordable(component.variables)]
    return [*own, *system.outputs]


@contextmanager
def _located(where: str) -> Iterator[None]:
    """Put the place in the file in front of what the system says of a name or a value there."""
    try:
        yield
    except NdobError as error:
        raise type(error)(f"{where}: {error}") from error
