"""The observer over a recorded log: our master beside a loop that only calls the FMU, and the memory of a CSV file.

    python -m benchmarks.input_log memory

prints by how much writing a large recording as CSV raises the peak memory of this process, and the recording's size
(bytes).
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ndob_fmu.results.csv_files import read_csv, write_csv
from ndob_fmu.results.recording import Recording

SIGNALS = ("plant.motor_angle", "plant.link_angle")
_LARGE = (200_000, 100)  # rows, signals


@dataclass(frozen=True)
class Replay:
    """An observer's FMU, the CSV file with a column for each of its inputs at every step, and the step size in s."""

    observer: Path
    log: Path
    step_size: float
    steps: int


class Memory(NamedTuple):
    """What writing takes above the recording, and the recording, in bytes."""

    above: int
    recording: int


def record(system: Path, observer: Path, log: Path, *, step_size: float = 1e-3, steps: int = 25_000) -> Replay:
    """Simulate the coupled system and keep what its observer reads as a log."""
    from ndob_fmu.cosim import simulate

    run = simulate(system, stop_time=steps * step_size, step_size=step_size, progress=False)
    columns = np.column_stack([run[name] for name in SIGNALS] + [np.zeros(len(run.time))])
    names = [*(name.partition(".")[2] for name in SIGNALS), "motor_torque"]
    write_csv(log, Recording(run.time, tuple(names), columns))
    return Replay(observer, log, step_size, steps)


def ours(replay: Replay) -> None:
    """Run our master, from the paths of FMU and log to the recorded outputs."""
    from ndob_fmu.cosim import simulate

    simulate(
        replay.observer,
        stop_time=replay.steps * replay.step_size,
        step_size=replay.step_size,
        input_file=replay.log,
        progress=False,
    )


def bare(replay: Replay) -> None:
    """Make the same FMI calls through fmpy's functions, with the log and one array of outputs in memory."""
    from fmpy import extract, fmi2, read_model_description

    table = read_csv(replay.log)
    description = read_model_description(str(replay.observer))
    folder = extract(str(replay.observer))
    fmu = fmi2.FMU2Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="observer",
    )
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0, stopTime=replay.steps * replay.step_size)
    fmu.enterInitializationMode()
    variables = {variable.name: variable for variable in description.modelVariables}

    def references(names: list[str]) -> tuple[object, int]:
        return (fmi2.fmi2ValueReference * len(names))(*(variables[n].valueReference for n in names)), len(names)

    def outputs(kind: str) -> list[str]:
        return [name for name, v in variables.items() if (v.causality, v.type) == ("output", kind)]

    inputs, input_count = references(list(table.names))
    reals, real_count = references(outputs("Real"))
    flags, flag_count = references(outputs("Boolean"))
    samples, values = (fmi2.fmi2Real * input_count)(), (fmi2.fmi2Real * real_count)()
    truths = (fmi2.fmi2Boolean * flag_count)()
    bus = np.frombuffer(samples)
    bus[:] = table.columns[0]
    fmu.fmi2SetReal(fmu.component, inputs, input_count, samples)
    fmu.exitInitializationMode()
    H = replay.step_size
    for k in range(replay.steps):
        bus[:] = table.columns[k]
        fmu.fmi2SetReal(fmu.component, inputs, input_count, samples)
        fmu.fmi2DoStep(fmu.component, k * H, H, fmi2.fmi2True)
        fmu.fmi2GetReal(fmu.component, reals, real_count, values)
        fmu.fmi2GetBoolean(fmu.component, flags, flag_count, truths)
    fmu.terminate()
    fmu.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)


def memory_of_csv() -> Memory:
    """Return what it takes to write a large recording, measured in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.input_log", "memory"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[1])
    return Memory(*map(int, done.stdout.split()))


def _measure_memory() -> Memory:
    import resource

    rows, signals = _LARGE
    columns = np.random.default_rng(1).standard_normal((rows, signals))
    recording = Recording(np.arange(rows) * 1e-3, tuple(f"signal_{k}" for k in range(signals)), columns)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as folder:
        write_csv(Path(folder, "result.csv"), recording)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Memory((after - before) * 1024, columns.nbytes)  # Linux counts in KiB


if __name__ == "__main__":
    print(*_measure_memory())
