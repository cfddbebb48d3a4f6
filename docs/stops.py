"""Print the stops on the way of a model to its FMUs, and of a sample to d̂: python docs/stops.py [REPOSITORY].

A stop is a module, in the order in which the running program first calls a function of it; for the sample, whose way is
short, a stop is a function. REPOSITORY is another checkout of this project; the packages that both need are installed.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import FrameType
from typing import Any

STEP = 1e-3  # s
_UNTIL_CONVERGED = 3000  # steps


def main(repository: Path) -> None:
    """Build the FMUs of the paper's example, step the observer until its gain has converged, and print both ways."""
    sys.path.insert(0, str(repository))
    from ndob_fmu import build, load_model

    with tempfile.TemporaryDirectory() as folder:
        model = load_model("flexible_joint")
        with stops(_module_in(repository / "ndob_fmu")) as found:
            build(model, folder)
        print(f"a model to its FMUs: {len(found)} modules")
        _print(found)
        fmu = Path(folder, f"{model.name}Observer.fmu")
        with stops(_function_in_fmu) as found:
            _step(fmu, found.clear)
        print(f"\na sample to d̂, once the gain has converged: {len(found)} functions")
        _print(found)


@contextmanager
def stops(name: Callable[[FrameType], str | None]) -> Iterator[list[str]]:
    """Give a list that grows by the name of each called frame, where it has one and is new."""
    found: list[str] = []

    def note(frame: FrameType, event: str, _argument: Any) -> None:
        if event == "call" and frame.f_code.co_flags & CO_OPTIMIZED:  # a function, not the body of a module or class
            stop = name(frame)
            if stop is not None and stop not in found:
                found.append(stop)

    sys.setprofile(note)
    try:
        yield found
    finally:
        sys.setprofile(None)


def _module_in(package: Path) -> Callable[[FrameType], str | None]:
    def name(frame: FrameType) -> str | None:
        path = Path(frame.f_code.co_filename)
        return path.relative_to(package).as_posix() if path.is_relative_to(package) else None

    return name


def _function_in_fmu(frame: FrameType) -> str | None:
    path, code = Path(frame.f_code.co_filename), frame.f_code
    if "resources" not in path.parts or code.co_name.startswith("<"):
        return None
    return f"{path.name}: {code.co_name}"


def _step(fmu: Path, forget: Callable[[], None]) -> None:
    """Step the observer at constant samples, and forget what was found before the last step."""
    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave

    description = read_model_description(fmu)
    references = {v.name: v.valueReference for v in description.modelVariables}
    inputs = [v.valueReference for v in description.modelVariables if v.causality == "input"]
    with tempfile.TemporaryDirectory() as folder:
        extract(fmu, folder)
        slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="observer",
        )
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        for step in range(_UNTIL_CONVERGED):
            if step == _UNTIL_CONVERGED - 1:
                forget()
            slave.setReal(inputs, [0.0] * len(inputs))
            slave.doStep(step * STEP, STEP)
            slave.getReal([references["load_torque_hat"]])
        slave.terminate()
        slave.freeInstance()


def _print(found: list[str]) -> None:
    for stop in found:
        print(f"    {stop}")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else Path(__file__).resolve().parents[1])
