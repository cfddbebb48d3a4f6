"""The demo, 20 s at 1 ms, in our master, in others on the same FMUs, and in a loop that only calls them.

    python -m benchmarks.coupling TOOL JOB.json

runs one tool in this process and prints how long a run took, on the clock and of the processors (s): from the paths of
the files to the recorded signals, imports left out. The tools run in processes of their own, where none finds what
another has loaded, and because some end theirs badly.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

CONNECTIONS = ("motor_angle", "link_angle")


@dataclass(frozen=True)
class Job:
    """package: path of the SSP that the tools run; plant, observer: of its FMUs, which the bare loop runs."""

    package: str
    plant: str
    observer: str
    step_size: float = 1e-3
    steps: int = 20_000

    @property
    def stop_time(self) -> float:
        """End of the run (s)."""
        return self.steps * self.step_size


class Spent(NamedTuple):
    """Time on the clock and of the processors (s)."""

    clock: float
    processors: float


def ours(job: Job) -> None:
    """Run our master, which records every output."""
    from ndob_fmu.cosim import simulate

    simulate(job.package, stop_time=job.stop_time, step_size=job.step_size, progress=False)


def bare(job: Job) -> None:
    """Make the same calls of fmpy in a loop, with the same memory for all steps, and record nothing.

    The observer reads the samples where the plant has written them: a coupling cannot do less.
    """
    from fmpy import extract, fmi2, read_model_description

    fmus: dict[str, Any] = {}
    folders, references = [], {}
    for name in ("plant", "observer"):
        path = getattr(job, name)
        description = read_model_description(path)
        folders.append(extract(path))
        fmu = fmi2.FMU2Slave(
            guid=description.guid,
            unzipDirectory=folders[-1],
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        fmu.instantiate()
        fmu.setupExperiment(startTime=0.0, stopTime=job.stop_time)
        fmus[name] = fmu
        references[name] = {v.name: v for v in description.modelVariables}
    plant, observer = fmus["plant"], fmus["observer"]
    for fmu in fmus.values():
        fmu.enterInitializationMode()

    def outputs(name: str, kind: str) -> tuple[Any, int]:
        chosen = [v.valueReference for v in references[name].values() if (v.causality, v.type) == ("output", kind)]
        return (fmi2.fmi2ValueReference * len(chosen))(*chosen), len(chosen)

    plant_outputs, plant_count = outputs("plant", "Real")
    observer_outputs, observer_count = outputs("observer", "Real")
    flags, flag_count = outputs("observer", "Boolean")
    inputs = (fmi2.fmi2ValueReference * 2)(*(references["observer"][name].valueReference for name in CONNECTIONS))
    plant_memory, observer_memory = (fmi2.fmi2Real * plant_count)(), (fmi2.fmi2Real * observer_count)()
    flag_memory = (fmi2.fmi2Boolean * flag_count)()
    samples = (fmi2.fmi2Real * 2).from_buffer(plant_memory)
    plant.fmi2GetReal(plant.component, plant_outputs, plant_count, plant_memory)
    observer.fmi2SetReal(observer.component, inputs, 2, samples)
    for fmu in fmus.values():
        fmu.exitInitializationMode()
    H = job.step_size
    for k in range(job.steps):
        t = k * H
        plant.fmi2DoStep(plant.component, t, H, fmi2.fmi2True)
        observer.fmi2SetReal(observer.component, inputs, 2, samples)
        observer.fmi2DoStep(observer.component, t, H, fmi2.fmi2True)
        plant.fmi2GetReal(plant.component, plant_outputs, plant_count, plant_memory)
        observer.fmi2GetReal(observer.component, observer_outputs, observer_count, observer_memory)
        observer.fmi2GetBoolean(observer.component, flags, flag_count, flag_memory)
    for fmu, folder in zip(fmus.values(), folders, strict=True):
        fmu.terminate()
        fmu.freeInstance()
        shutil.rmtree(folder, ignore_errors=True)


def libcosimpy(job: Job, *, record: bool = True) -> None:
    """libcosim with its own loop; where it records, it keeps every Real output in memory."""
    from libcosimpy.CosimEnums import CosimVariableCausality, CosimVariableType
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.WARNING)
    execution = CosimExecution.from_ssp_file(job.package, round(job.step_size * 1e9))
    if record:
        observer = CosimObserver.create_time_series(buffer_size=job.steps + 1)
        assert execution.add_observer(observer)
        for index in range(execution.num_slaves()):
            for variable in execution.slave_variables(index):
                output = variable.causality == CosimVariableCausality.OUTPUT.value
                if output and variable.type == CosimVariableType.REAL.value:
                    assert observer.start_time_series(index, variable.reference, CosimVariableType.REAL)
    assert execution.simulate_until(round(job.stop_time * 1e9))


def ecospy(job: Job, *, record: bool = True) -> None:
    """ecos with its own loop; where it records, it writes every output into a CSV file, which is all that it offers."""
    from ecospy import EcosSimulation

    simulation = EcosSimulation(ssp_path=job.package, step_size=job.step_size)
    if record:
        simulation.add_csv_writer("result.csv")
    assert simulation.init(parameter_set="nominal")
    simulation.step(job.steps)
    simulation.terminate()
    simulation.free()


TOOLS: dict[str, Callable[[Job], None]] = {
    "ours": ours,
    "bare loop": bare,
    "libcosimpy": libcosimpy,
    "libcosimpy, records nothing": lambda job: libcosimpy(job, record=False),
    "ecospy": ecospy,
    "ecospy, records nothing": lambda job: ecospy(job, record=False),
}
_IMPORTS = {"ours": "ndob_fmu.cosim.simulation", "bare loop": "fmpy.fmi2"}


def spent(tool: str, job: Job, folder: Path) -> Spent:
    """Return what a run in the tool takes, in a process of its own, which works in the folder."""
    with tempfile.TemporaryDirectory(dir=folder) as work:
        described = Path(work, "job.json")
        described.write_text(json.dumps(asdict(job)), "utf-8")
        environment = os.environ | {"TMPDIR": work, "PYTHONPATH": str(Path(__file__).parents[1])}
        command = [sys.executable, "-m", "benchmarks.coupling", tool, str(described)]
        done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True, check=False)
        lines = [line for line in done.stdout.splitlines() if line.startswith("spent ")]
        assert lines, f"{tool}: {done.stderr}"  # what comes after a run's end does not spoil it
    return Spent(*map(float, lines[-1].split()[1:]))


def main(tool: str, described: str) -> None:
    """Run the tool and print what it took."""
    __import__(_IMPORTS.get(tool, tool.partition(",")[0]))
    job = Job(**json.loads(Path(described).read_text("utf-8")))
    begin, begin_of_processors = perf_counter(), process_time()
    TOOLS[tool](job)
    print("spent", perf_counter() - begin, process_time() - begin_of_processors, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
