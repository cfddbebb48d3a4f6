"""What native FMUs run on each platform: the reference experiments of fmus/, hard ones, and each component."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fmus.tools.regression import START_VALUES, experiments, read_columns
from ndob_fmu.fmu.components import records
from ndob_fmu.runtime.blocks.disturbance import KINDS
from ndob_fmu.runtime.blocks.disturbance_source import SOURCE_KINDS

STEPS, H = 1000, 1e-3
NOISE = 1e-5
_FAULTS = {
    "adapt_noise": 1,
    "lag": 0.05,
    "link_angle_delay": 0.02,
    "motor_angle_bias_std": 0.01,
    "gravity_torque_std": 0.1,
}
_SAMPLED = {
    "noise_std": 0.1,
    "bias": 0.02,
    "seed": 3,
    "dropout_probability": 0.2,
    "delay": 0.0137,
    "sample_time": 0.0025,
}

# The names of the experiments.
NAMES = [
    *(f"FlexibleJoint{part}{ending}" for part in ("Observer", "Plant") for ending in ("", "_paper")),
    *("observer, faults", "plant, warnings", "Encoder", "Sensor", "TorsionSpring"),
    *(f"DisturbanceSource, {kind}" for kind in SOURCE_KINDS),
]


@dataclass(frozen=True)
class Experiment:
    """A run of an FMU: start values, and columns of inputs; it makes as many steps as these have rows."""

    fmu: str
    step_size: float
    rows: int
    inputs: Mapping[str, np.ndarray] = field(default_factory=dict)
    start_values: Mapping[str, float | Path] = field(default_factory=dict)


def native_experiments(folder: Path) -> dict[str, Experiment]:
    """Return the experiments by name; the folder gets the profile that one of them reads."""
    return {**_references(), "observer, faults": _faulty(), "plant, warnings": _warned(), **_components(folder)}


def _references() -> dict[str, Experiment]:
    found = {}
    for each in experiments():
        options, path = each.options, each.folder / f"{each.stem}_in.csv"
        inputs = read_columns(path) if path.exists() else {}
        inputs.pop("time", None)
        rows = round(options["StopTime"] / options["StepSize"])
        given = {name: column[:rows] for name, column in inputs.items()}
        name, value = START_VALUES.get(each.stem, ("", ""))
        found[each.stem] = Experiment(each.fmu, options["StepSize"], rows, given, {name: int(value)} if name else {})
    return found


def _faulty() -> Experiment:
    """Return the observer with samples that are noisy, late, lost, and wrong, and all that it can do about them."""
    reference, rows = _references()["FlexibleJointObserver"], 400
    random = np.random.default_rng(7)
    columns = {name: column[:rows].copy() for name, column in reference.inputs.items()}
    for name in ("motor_angle", "link_angle"):
        columns[name] += NOISE * random.standard_normal(rows)
    columns["motor_angle"][100] += 0.5
    columns["link_angle"][200:220] = np.nan
    columns["motor_angle"][210:215] = np.inf
    columns["link_angle"][300:] += 2.0
    noise = {f"{name}_noise_std": NOISE for name in ("motor_angle", "link_angle")}
    return Experiment(reference.fmu, reference.step_size, rows, columns, noise | _FAULTS)


def _warned() -> Experiment:
    """Return the plant with inputs that are not finite, of which it warns."""
    torque = np.where(np.arange(STEPS) % 50 == 3, np.nan, 0.3)
    wave = {"disturbance.kind": KINDS["sine"], "disturbance.amplitude": 1.5, "disturbance.frequency": 0.8}
    return Experiment("FlexibleJointPlant", H, STEPS, {"motor_torque": torque, "load_torque": 0.1 + 0.0 * torque}, wave)


def _components(folder: Path) -> dict[str, Experiment]:
    profile = folder / "wind.csv"
    profile.write_text("time,value\n0.0,1.5\n0.2,-2.25\n0.7,3e-1\n", "utf-8")
    wave = {"amplitude": 1.3, "frequency": 3.7, "start_time": 0.0333}
    found = {
        f"DisturbanceSource, {kind}": _component(
            "DisturbanceSource",
            {f"disturbance.{name}": value for name, value in wave.items()}
            | {"disturbance.kind": number}
            | ({"disturbance.profile": profile} if kind == "profile" else {}),
        )
        for kind, number in SOURCE_KINDS.items()
    }
    found["TorsionSpring"] = _component("TorsionSpring", {"stiffness": 3.7})
    return found | {name: _component(name, _SAMPLED) for name in ("Sensor", "Encoder")}


def _component(name: str, start_values: Mapping[str, float | Path]) -> Experiment:
    (record,) = (record for record in records() if record.name == name)
    inputs = [variable.name for variable in record.variables if variable.causality == "input"]
    columns = {each: np.sin((0.03 + 0.01 * i) * np.arange(STEPS)) for i, each in enumerate(inputs)}
    return Experiment(name, H, STEPS, columns, start_values)
