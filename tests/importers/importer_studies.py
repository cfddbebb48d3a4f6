"""What the importers run, and our own master's trajectories of it, which are the reference."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ndob_fmu.cosim import FmuComponent, Port, System, open_ssp, simulate
from ndob_fmu.results.csv_files import write_csv
from ndob_fmu.results.recording import Recording
from tests.importers.importers import Rows, Study

PLANT = ("link_angle", "motor_angle", "link_rate", "motor_rate", "load_torque_total")
OBSERVER = (
    *("link_angle_hat", "motor_angle_hat", "link_rate_hat", "motor_rate_hat", "load_torque_hat"),
    *("load_torque_at_sample", "load_torque_std", "link_angle_residual", "motor_angle_residual"),
)


def plant_alone(plant: Path, _observer: Path) -> Study:
    starts = {"plant.motor_torque": 0.3, "plant.load_torque": 0.1, "plant.disturbance.amplitude": 1.5}
    return Study({"plant": str(plant)}, starts=starts, shown=_columns(plant=PLANT), steps=3000)


def run_again(plant: Path, observer: Path) -> Study:
    return replace(plant_alone(plant, observer), steps=500, again=True)


def observer_alone(plant: Path, observer: Path, steps: int = 2000) -> Study:
    """The observer with what a plant gave, under a torque that changes at each step."""
    torque = np.sin(np.arange(steps + 1) * 5e-3)
    driven = Study(
        {"plant": str(plant)},
        starts={"plant.load_torque": 0.0},
        inputs={"plant.motor_torque": tuple(torque)},
        shown=_columns(plant=("motor_angle", "link_angle")),
        steps=steps,
    )
    recorded = (torque, *reference(driven)[:, 1:].T)
    inputs = {f"observer.{name}": tuple(v) for name, v in zip(("motor_torque", *PLANT[1::-1]), recorded, strict=True)}
    starts = {f"observer.{name}_noise_std": 1e-5 for name in ("motor_angle", "link_angle")}
    shown = _columns(observer=OBSERVER)
    return Study({"observer": str(observer)}, starts=starts, inputs=inputs, shown=shown, steps=steps)


def coupled_twice(plant: Path, observer: Path) -> Study:
    """Two instances of either FMU in one system, with different parameters."""
    starts, connections = {}, []
    for number, amplitude in enumerate((1.0, -3.0)):
        starts |= {f"plant{number}.motor_torque": 0.2, f"observer{number}.motor_torque": 0.2}
        starts |= {f"plant{number}.load_torque": 0.0, f"plant{number}.disturbance.amplitude": amplitude}
        sigma = 10.0 ** (-6 + number)
        starts |= {f"observer{number}.{name}_noise_std": sigma for name in ("motor_angle", "link_angle")}
        connections += [(f"plant{number}.{name}", f"observer{number}.{name}") for name in ("link_angle", "motor_angle")]
    return Study(
        {"plant0": str(plant), "observer0": str(observer), "plant1": str(plant), "observer1": str(observer)},
        connections=tuple(connections),
        starts=starts,
        shown=_columns(plant0=PLANT, observer0=OBSERVER, plant1=PLANT, observer1=OBSERVER),
        steps=1000,
    )


def shipped(package: Path) -> Study:
    return Study(package=str(package), shown=_columns(plant=PLANT, observer=OBSERVER), steps=3000)


def shorter(study: Study, at_most: int) -> Study:
    """Return the study, or its beginning of so many steps."""
    steps = min(study.steps, at_most)
    return replace(study, steps=steps, inputs={name: values[: steps + 1] for name, values in study.inputs.items()})


def _columns(**names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{instance}.{name}" for instance, of_instance in names.items() for name in of_instance)


def as_one_block(package: Path, steps: int = 100) -> Study:
    """A package with names at its boundary: all inputs there are set, all Real outputs there are shown."""
    with open_ssp(package) as (system, _):
        shown = tuple(name for name, link in system.outputs.items() if system.variable(link.port).type == "Real")
        starts = dict.fromkeys(system.inputs, 0.1)
    return Study(package=str(package), starts=starts, shown=shown, steps=steps)


def reference(study: Study) -> Rows:
    """Return the rows of our own master."""
    run = {"stop_time": study.times[-1], "step_size": study.step_size}
    if study.package:
        found = simulate(study.package, start_values=study.starts, **run)
        return np.column_stack([found.time, *(found[column] for column in study.shown)])
    system = System(
        {name: FmuComponent(path, name) for name, path in study.instances.items()},
        connections=tuple((_port(source), _port(target)) for source, target in study.connections),
        start_values={_port(name): value for name, value in study.first.items()},
    )
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as folder:
        if study.inputs:
            run["input_file"] = Path(folder) / "inputs.csv"
            write_csv(
                run["input_file"], Recording(study.times, tuple(study.inputs), np.array([*study.inputs.values()]).T)
            )
        found = simulate(system, **run)
    return np.column_stack([found.time, *(found[column] for column in study.shown)])


def _port(name: str) -> Port:
    return Port(*name.split(".", 1))
