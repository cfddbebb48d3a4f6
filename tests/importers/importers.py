"""Tools that import the FMUs: each runs the same study in a process of its own, which has this package not.

    python tests/importers/importers.py TOOL STUDY.json ROWS.npy

writes the trajectory of the study: one row per communication point, the time first, then what the study shows.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.float64]
T = TypeVar("T")


@dataclass(frozen=True)
class Study:
    """FMUs by the names of their instances, or an SSP package of them, and how they are run, from t = 0.

    parameter_set: the name of that in the package; of the tools only ecos asks for it.
    connections: (source, target), each ``instance.variable``. starts: of Real parameters and inputs. inputs: for an
    input the values that it has from each communication point on. shown: Real outputs. again: the rows are those of a
    second run, after the tool has made another one of ten steps and started over.
    """

    instances: Mapping[str, str] = field(default_factory=dict)
    package: str | None = None
    parameter_set: str = "nominal"
    connections: tuple[tuple[str, str], ...] = ()
    starts: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    shown: tuple[str, ...] = ()
    step_size: float = 1e-3
    steps: int = 1000
    again: bool = False

    @property
    def first(self) -> dict[str, float]:
        """Start values, those of recorded inputs among them."""
        return {**self.starts, **{port: values[0] for port, values in self.inputs.items()}}

    @property
    def times(self) -> Rows:
        """The communication points."""
        return np.arange(self.steps + 1) * self.step_size


def fmpy(study: Study) -> Rows:
    """fmpy's simulate_fmu, which runs one FMU; it starts over by fmi2Reset of the instance."""
    from fmpy import extract, instantiate_fmu, read_model_description, simulate_fmu

    ((name, path),) = study.instances.items()
    columns = [column.removeprefix(f"{name}.") for column in study.shown]
    table = [("time", *(port.removeprefix(f"{name}.") for port in study.inputs))]
    inputs = None
    if study.inputs:
        inputs = np.empty(study.steps + 1, [(column, np.float64) for column in table[0]])
        for column, values in zip(table[0], (study.times, *study.inputs.values()), strict=True):
            inputs[column] = values
    instance = None
    if study.again:
        folder, description = extract(path), read_model_description(path)
        instance = instantiate_fmu(folder, description, fmi_type="CoSimulation")

    def run(steps: int) -> NDArray[np.void]:
        return simulate_fmu(
            path,
            stop_time=study.step_size * steps,
            output_interval=study.step_size,
            start_values={port.removeprefix(f"{name}."): value for port, value in study.starts.items()},
            input=inputs,
            output=columns,
            fmu_instance=instance,
        )

    if study.again:
        run(10)
        instance.reset()
    found = run(study.steps)
    return np.column_stack([found["time"], *(found[column] for column in columns)])


def fmucontainer(study: Study) -> Rows:
    """The package as one FMU, a container of fmu-manipulation-toolbox with the names at the boundary, in fmpy."""
    package = Path(shutil.copy(study.package, Path.cwd()))
    command = shutil.which("fmucontainer", path=str(Path(sys.executable).parent))
    subprocess.run([command, "-container", package.name], check=True, capture_output=True)
    return fmpy(replace(study, package=None, instances={"container": str(package.with_suffix(".fmu"))}))


def libcosimpy(study: Study) -> Rows:
    """libcosim, told what the study is by its functions, or given the package; it starts over by a new execution."""
    from fmpy import read_model_description
    from libcosimpy.CosimEnums import CosimVariableType
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.WARNING)
    if study.again:
        libcosimpy(replace(study, steps=10, again=False))
    interval = round(study.step_size * 1e9)
    if study.package:
        execution = CosimExecution.from_ssp_file(study.package, interval)
        references = {}
        for index in range(execution.num_slaves()):
            name = next(info.name.decode() for info in execution.slave_infos() if info.index == index)
            for variable in execution.slave_variables(index):
                references[f"{name}.{variable.name.decode()}"] = (index, variable.reference)
    else:
        execution = CosimExecution.from_step_size(interval)
        references = {}
        for name, path in study.instances.items():
            index = execution.add_local_slave(CosimLocalSlave(path, name))
            for variable in read_model_description(path).modelVariables:
                references[f"{name}.{variable.name}"] = (index, variable.valueReference)
    for port, value in study.first.items():
        assert execution.real_initial_value(*references[port], value), port
    for source, target in study.connections:
        assert execution.connect_real_variables(*references[source], *references[target]) == 0, (source, target)
    observer = CosimObserver.create_time_series()
    assert execution.add_observer(observer)
    manipulator = CosimManipulator.create_override()
    assert execution.add_manipulator(manipulator)
    for column in study.shown:
        assert observer.start_time_series(*references[column], CosimVariableType.REAL), column
    for k in range(study.steps):
        for port, values in study.inputs.items():
            index, reference = references[port]
            assert manipulator.slave_real_values(index, [reference], [values[k]]), port
        execution.step()  # libcosimpy 0.0.4 returns False for every step; the status is right in all versions
        status = execution.status()
        assert (status.error_code, status.current_time) == (0, (k + 1) * interval), k

    def series(column: str) -> tuple[list[int], list[float]]:
        # libcosimpy cuts off as many samples as have the step number 0: the first one has to be asked for by itself.
        first, rest = (
            observer.time_series_real_samples(*references[column], start, count)
            for start, count in ((0, 2), (1, study.steps))
        )
        return first[0] + rest[0], first[2] + rest[2]

    times = np.array(series(study.shown[0])[0]) * 1e-9
    return np.column_stack([times, *(series(column)[1] for column in study.shown)])


def ecospy(study: Study) -> Rows:
    """ecos, told what the study is by its library's functions, or given the package; it starts over by a reset."""
    from ecospy import EcosSimulation, EcosSimulationStructure

    def named(port: str) -> str:
        return port.replace(".", "::", 1)

    if study.package:
        simulation, parameters = EcosSimulation(ssp_path=study.package, step_size=study.step_size), study.parameter_set
    else:
        with EcosSimulationStructure() as structure:
            for name, path in study.instances.items():
                structure.add_model(name, path)
            for source, target in study.connections:
                structure.make_real_connection(named(source), named(target))
            parameters = "starts"
            structure.add_parameter_set(parameters, {named(port): value for port, value in study.first.items()})
            simulation = EcosSimulation(structure=structure, step_size=study.step_size)

    def row() -> list[float]:
        return [simulation.get_time(), *(simulation.get_real(named(column)) for column in study.shown)]

    if study.again:
        assert simulation.init(parameter_set=parameters)
        simulation.step(10)
        simulation.reset()
    assert simulation.init(parameter_set=parameters)
    rows = [row()]
    for k in range(study.steps):
        for port, values in study.inputs.items():
            simulation.set_real(named(port), values[k])
        simulation.step()
        rows.append(row())
    simulation.terminate()
    simulation.free()
    return np.array(rows)


def gemseo_fmu(study: Study) -> Rows:
    """gemseo-fmu, one FMU in fmpy. It sets what it is given also after initialization: inputs, no fixed parameters."""
    from gemseo_fmu.disciplines.fmu_discipline import FMUDiscipline

    ((name, path),) = study.instances.items()
    columns = [column.removeprefix(f"{name}.") for column in study.shown]
    given = {port: np.array([value]) for port, value in _bare(name, study.starts).items()}
    given |= {port: _held(values, study.step_size) for port, values in _bare(name, study.inputs).items()}
    discipline = FMUDiscipline(
        path,
        input_names=list(given),  # without it all parameters too, each set as a Real
        output_names=columns,
        final_time=study.times[-1],
        time_step=study.step_size,
    )
    found = discipline.execute(given)
    return np.column_stack([found[f"{discipline.name}_time"], *(found[column] for column in columns)])


def pathsim_fmi(study: Study) -> Rows:
    """pathsim-fmi, one FMU. It makes the step from t when it comes to t, so that outputs are seen one step early."""
    from pathsim import Connection, Simulation
    from pathsim.blocks import Scope, Source
    from pathsim_fmi import CoSimulationFMU

    ((name, path),) = study.instances.items()
    fmu = CoSimulationFMU(path, name, _bare(name, study.first), study.step_size)
    constant = {port: (value,) * (study.steps + 1) for port, value in study.starts.items()}
    driven = {port: values for port, values in _bare(name, constant | dict(study.inputs)).items() if port in fmu.inputs}
    sources = {port: Source(_held(values, study.step_size)) for port, values in driven.items()}
    connections = [Connection(source, fmu[port]) for port, source in sources.items()]
    scope = Scope()
    columns = [column.removeprefix(f"{name}.") for column in study.shown]
    connections += [Connection(fmu[column], scope[k]) for k, column in enumerate(columns)]
    before = [fmu.outputs[column] for column in columns]
    simulation = Simulation([fmu, scope, *sources.values()], connections, dt=study.step_size, log=False)
    simulation.run(study.times[-2])
    _, found = scope.read()
    return np.column_stack([study.times, np.vstack([before, np.transpose(found)])])


def cofmupy(study: Study) -> Rows:
    """CoFmuPy, one FMU. Its results begin with the first step's end; what is before is asked for by itself."""
    from cofmupy import Coordinator

    ((name, path),) = study.instances.items()
    names = [(name, column.removeprefix(f"{name}.")) for column in study.shown]
    # It adds times up and takes the row before: each row stands half a step before it is wanted.
    early = [repr(float(time)) for time in study.times - study.step_size / 2]
    connections = [
        {
            "source": {"type": "literal", "values": dict(zip(early, values, strict=True))},
            "target": {"type": "fmu", "id": name, "variable": port},
        }
        for port, values in _bare(name, study.inputs).items()
    ]
    fmu = {"id": name, "name": name, "path": path, "initialization": _bare(name, study.first)}
    coordinator = Coordinator()
    coordinator.start({"fmus": [fmu], "connections": connections})
    rows = [[coordinator.get_variable(column)[0] for column in names]]
    for _ in range(study.steps):
        coordinator.do_step(study.step_size)
    found = coordinator.get_results()
    rows += zip(*(found[column] for column in names), strict=True)
    return np.column_stack([study.times, rows])


def _bare(name: str, ports: Mapping[str, T]) -> dict[str, T]:
    return {port.removeprefix(f"{name}."): value for port, value in ports.items()}


def _held(values: tuple[float, ...], step_size: float) -> Callable[[float], float]:
    return lambda time: values[round(time / step_size)]


TOOLS: dict[str, Callable[[Study], Rows]] = {
    tool.__name__.replace("_", "-"): tool
    for tool in (fmpy, fmucontainer, libcosimpy, ecospy, gemseo_fmu, pathsim_fmi, cofmupy)
}


def main(tool: str, study: str, rows: str) -> None:
    """Run the study in the tool, which unpacks FMUs in the working folder."""
    os.environ["TMPDIR"] = str(Path.cwd())
    np.save(rows, TOOLS[tool](Study(**json.loads(Path(study).read_text("utf-8")))))


if __name__ == "__main__":
    main(*sys.argv[1:])
