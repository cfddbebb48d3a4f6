"""The simulation of a system, a package or a single FMU in one call, which returns the recorded signals."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from ndob_fmu.cosim.component import Value
from ndob_fmu.cosim.default_experiment import DefaultExperiment
from ndob_fmu.cosim.fmi.fmu_component import FmuComponent
from ndob_fmu.cosim.master import fixed_step
from ndob_fmu.cosim.ssp import open_ssp
from ndob_fmu.cosim.system.inputs import NO_INPUTS, read_inputs
from ndob_fmu.cosim.system.loops import algebraic_loops
from ndob_fmu.cosim.system.ports import Port
from ndob_fmu.cosim.system.system import System
from ndob_fmu.cosim.system.wiring import Wiring, keep_start_values, wire
from ndob_fmu.cosim.time_grid import TimeGrid
from ndob_fmu.errors import UsageError, shortened
from ndob_fmu.results.recording import FailedRunError, Recording
from ndob_fmu.support.interrupts import interruptible

_log = logging.getLogger(__name__)


def simulate(
    system: System | str | Path,
    *,
    start_time: float | None = None,
    stop_time: float | None = None,
    step_size: float | None = None,
    output_interval: float | None = None,
    start_values: Mapping[str, Value] | None = None,
    input_file: str | Path | None = None,
    scheme: str = "jacobi",
    order: Sequence[str] | None = None,
    tolerance: float | None = None,
    strict: bool = False,
    progress: bool | None = None,
) -> Recording:
    """Co-simulate with a fixed communication step and return every numeric output, one row per communication point.

    system: a System, or the path of an .ssp or .fmu. Variables of a single .fmu may be named without the component.
    start_time, stop_time, step_size: s; None takes that of the default experiment, for the start time else 0.
    output_interval: s between rows; None records each communication point.
    start_values: ``component.variable`` → value; a connected input has it before the first exchange.
    input_file: CSV in fmpy's form with columns ``component.variable``; each row holds until the next.
    scheme: ``jacobi``: all components step at once, with inputs held since the step's beginning; ``gauss-seidel``: one
        after another, each with the values that those before it have at the step's end; ``extrapolation``: all at once,
        with inputs extrapolated to the step's middle, of second order for smooth signals.
    order: the components' names in the order of gauss-seidel; None means the system's order.
    tolerance: relative, for the FMUs' own solvers; None is that of each FMU's default experiment.
    strict: refuse an input that nothing drives and that has no start value of the system or the call. Otherwise it
        keeps its FMU's start value, after SSP 1.0.1, and a warning names it.
    progress: whether to show a bar on stderr for runs longer than 2 s; None shows it on terminals only.

    An FMU that ends the simulation ends the run at that time: the last row is then before the stop time,
    ``Recording.ended_early`` says why, and a warning is logged.

    Raises UsageError for a value or file that cannot be used, CouplingError for a system that cannot be wired,
    FailedRunError, a SimulationError, for a component that fails; its ``recording`` has the rows before the failure.
    No component and no temporary file outlives the call.
    """
    with interruptible(), open_system(system, step_size) as (opened, experiment):
        grid = TimeGrid.over(
            _first(start_time, experiment.start_time, 0.0),
            _time("stop time", stop_time, experiment.stop_time),
            _time("step size", step_size, experiment.step_size),
            output_interval,
        )
        starts: dict[Port, Value] = {}
        for name, value in (start_values or {}).items():
            starts |= opened.starts(name, value)
        table = NO_INPUTS if input_file is None else read_inputs(input_file, opened)
        if order is not None and scheme != "gauss-seidel":
            raise UsageError.report("order", expected="the scheme gauss-seidel", received=repr(scheme))
        wiring = wire(opened, table, starts, order, strict=strict)
        warn(wiring)
        try:
            found = fixed_step.run(wiring, grid, scheme=scheme, progress=progress, tolerance=_positive(tolerance))
        except FailedRunError as error:
            error.recording = error.recording and _with_outputs(opened, error.recording)
            raise
        for text in (found.ended_early, _nan(found)):
            if text:
                _log.warning("%s", shortened(text))
        return _with_outputs(opened, found)


def start_values_of_components(system: System | str | Path, values: Mapping[str, Value]) -> dict[str, Value]:
    """Return start values as `simulate` takes them, where a parameter's name alone means each component that has it.

    values: by ``component.variable``, by the name of an input at the boundary, or by that of a parameter

    Raises CouplingError for a name that none of these is, UsageError for a value that it cannot have.
    """
    found: dict[str, Value] = {}
    with open_system(system) as (opened, _):
        for name, value in values.items():
            of_each = [
                f"{part}.{name}"
                for part, component in opened.components.items()
                if any(v.name == name and v.causality == "parameter" for v in component.variables)
            ]
            for port in of_each or [name]:
                opened.starts(port, value)
                found[port] = value
    return found


def _nan(recording: Recording) -> str:
    """Return a line about signals that are NaN at the end, and which of them was NaN first; empty if there are none."""
    lost = np.flatnonzero(np.isnan(recording.columns[-1]))
    if not lost.size:
        return ""
    known = ~np.isnan(recording.columns[::-1, lost])  # from the end to the start
    rows = np.where(known.any(axis=0), known.argmax(axis=0), len(known))
    first = int(rows.argmax())
    name, time = recording.names[lost[first]], recording.time[len(known) - rows[first]]
    many = f"{lost.size} of {len(recording.names)} signals are NaN at the end"
    return f"the run ends in NaN: {name} is the first, from t = {time:.12g} s on; {many}"


def _positive(tolerance: float | None) -> float | None:
    if tolerance is not None and not (math.isfinite(tolerance) and tolerance > 0):
        raise UsageError.report("tolerance", expected="a finite number > 0", received=repr(tolerance))
    return tolerance


def _with_outputs(system: System, recording: Recording) -> Recording:
    """Return the recording with the outputs at the system's boundary, after those of the components, and all units."""
    units = {str(port): system.variable(port).unit for port in map(system.port, recording.names)}
    units |= {name: system.variable(link.port).unit for name, link in system.outputs.items()}
    recording = replace(recording, units={name: unit for name, unit in units.items() if unit})
    if not system.outputs:
        return recording
    types = dict(zip(recording.names, recording.types, strict=True))
    links = system.outputs.values()
    return replace(
        recording,
        names=(*recording.names, *system.outputs),
        columns=np.column_stack(
            [recording.columns, *(recording[str(p)] * factor + offset for p, factor, offset in links)]
        ),
        types=(*recording.types, *(types[str(link.port)] for link in links)),
    )


def warn(wiring: Wiring) -> None:
    """Log what the author of this system may not expect of a run: one line for each kind."""
    for text in wiring.system.warnings:
        _log.warning("%s", shortened(text))
    if wiring.undriven:
        _log.warning("%s", keep_start_values(wiring.undriven))
    for loop in algebraic_loops(wiring.system, initial=False):
        if loop.declared:
            _log.warning(
                "algebraic loop %s: after the start FMI 2.0 lets nobody solve it, so that each step begins with values "
                "of the step before",
                loop,
            )


@contextmanager
def open_system(
    system: System | str | Path, step_size: float | None = None
) -> Iterator[tuple[System, DefaultExperiment]]:
    """Give the System itself, or the one behind the path of an .ssp or .fmu, with the default experiment, if any.

    step_size: the communication step (s), by default that of the experiment, of which an .ssp's components' own steps
    are multiples.
    """
    if isinstance(system, System):
        yield system, DefaultExperiment()
    elif Path(system).suffix == ".ssp":
        with open_ssp(system, step_size) as opened:
            yield opened
    elif Path(system).suffix == ".fmu":
        fmu = FmuComponent(system)
        yield System({fmu.name: fmu}), fmu.experiment
    else:
        raise UsageError.report(
            "system", expected="a System or the path of an .ssp or .fmu", received=repr(str(system))
        )


def _first(*candidates: float | None) -> float:
    return next(float(value) for value in candidates if value is not None)


def _time(name: str, given: float | None, default: float | None) -> float:
    if given is None and default is None:
        raise UsageError.report(
            name, expected="a number of seconds", received="none", likely="the system has no default for it; give one"
        )
    return _first(given, default)
