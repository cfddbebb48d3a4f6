"""Write the descriptions of the shipped systems into this folder.

    python -m ssp.regenerate FMUS

FMUS: the folder with the FMUs of `ndob-fmu build flexible_joint --components`. Each system gets a folder with its
description and its nominal parameter set; every other set lies in a folder inside, with files that replace these.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import hypot, pi, sqrt
from pathlib import Path

from ndob_fmu.cosim import System
from ndob_fmu.cosim.component import Value
from ndob_fmu.cosim.default_experiment import DefaultExperiment
from ndob_fmu.cosim.ssp.write import description_files
from ndob_fmu.support.files import atomic_path
from ssp.boundary import with_boundary
from ssp.nested import two_joints_full

HERE = Path(__file__).resolve().parent
STATES = ("link_angle", "link_rate", "motor_angle", "motor_rate")
MEASURED = ("motor_angle", "link_angle")

Values = dict[str, Value]


@dataclass(frozen=True)
class ParameterSet:
    """What a set changes: of the plant, of what observer and controller believe of it, and of the controller."""

    plant: Values = field(default_factory=dict)
    belief: Values = field(default_factory=dict)
    controller: Values = field(default_factory=dict)


SETS: Mapping[str, ParameterSet] = {
    "nominal": ParameterSet(),
    "heavy_arm": ParameterSet(plant={"gravity_torque": 50.0}, belief={"gravity_torque": 50.0}),
    "detuned": ParameterSet(belief={"joint_stiffness": 1.2}),  # 20 % more than it has
    "uncompensated": ParameterSet(controller={"compensation": False}),
}

RESOLUTION = 2.0 * pi / 4096  # of the encoders, in rad
NOISE = 5e-4  # rad, before the encoders round
TURNED = {"a": 1.0, "b": 0.0}  # rad, where the two arms start
SPRING = 2.0  # N·m/rad, between them
REFERENCE = {"link_angle_reference": ("controller.link_angle_reference",)}
SMALL_NOISE = 1e-5  # rad, where there is no encoder: as much as lets the observer bear a model that is not exact


def at_rest(suffix: str) -> Values:
    """Return start values of the hanging arm."""
    return {f"{state}{suffix}": 0.0 for state in STATES}


def noise_of_the_angles(sigma: float) -> Values:
    """Return the observer's parameters for samples of both angles with this noise (rad)."""
    return {f"{angle}_noise_std": sigma for angle in MEASURED}


def open_loop(fmus: Path, values: ParameterSet) -> System:
    """The paper's example: a single link with a flexible joint and its nonlinear disturbance observer, no feedback."""
    system = (
        System()
        .add("plant", fmus / "FlexibleJointPlant.fmu", {"motor_torque": 0.0, "load_torque": 0.0, **values.plant})
        .add("observer", fmus / "FlexibleJointObserver.fmu", {"method": 1, "motor_torque": 0.0, **values.belief})
    )
    for angle in MEASURED:
        system = system.connect(f"plant.{angle}", f"observer.{angle}")
    return system


def closed_loop(fmus: Path, values: ParameterSet, noise_std: float, *, encoders: bool) -> System:
    """A step of 2 N·m and a sine of 1 Hz and 1 N·m from 1 s on, estimated by the observer and compensated."""
    disturbance: Values = {"disturbance.kind": 4, "disturbance.amplitude": 2.0, "disturbance.start_time": 1.0}
    sine: Values = {"disturbance.kind": 3, "disturbance.amplitude": 1.0, "disturbance.start_time": 1.0}
    system = System().add("disturbance", fmus / "DisturbanceSource.fmu", disturbance)
    system = system.add("plant", fmus / "FlexibleJointPlant.fmu", {**sine, **at_rest("_start"), **values.plant})
    for seed, angle in enumerate(MEASURED if encoders else (), start=1):
        parameters: Values = {"noise_std": NOISE, "seed": seed}
        system = system.add(f"{angle}_encoder", fmus / "Encoder.fmu", parameters)
    known: Values = {f"{state}_hat_start_std": 0.1 for state in STATES}
    tuning: Values = {**noise_of_the_angles(noise_std), **at_rest("_hat_start"), **known, **values.belief}
    system = (
        system.add("observer", fmus / "FlexibleJointObserver.fmu", tuning)
        .add(
            "controller",
            fmus / "FlexibleJointController.fmu",
            {"link_angle_reference": 0.0, **values.belief, **values.controller},
        )
        .connect("disturbance.disturbance", "plant.load_torque")
        .connect("controller.motor_torque", "plant.motor_torque")
        .connect("controller.motor_torque", "observer.motor_torque")
    )
    for angle in MEASURED:
        if encoders:
            system = system.connect(f"plant.{angle}", f"{angle}_encoder.angle")
        source = f"{angle}_encoder.measured_angle" if encoders else f"plant.{angle}"
        system = system.connect(source, f"observer.{angle}")
    for name in (*STATES, "load_torque"):
        system = system.connect(f"observer.{name}_hat", f"controller.{name}_hat")
    return system


def disturbance_rejection(fmus: Path, values: ParameterSet) -> System:
    """The arm held still against a step of 2 N·m and a sine of 1 Hz, by feedback and compensation of the estimate."""
    return closed_loop(fmus, values, SMALL_NOISE, encoders=False)


def noisy_encoder(fmus: Path, values: ParameterSet) -> System:
    """The same loop with noisy encoders of 12 bits."""
    noise_std = hypot(NOISE, RESOLUTION / sqrt(12.0))
    return closed_loop(fmus, values, noise_std, encoders=True)


def still_plant() -> Values:
    """Return start values of an arm that nothing but its neighbour moves."""
    return {"disturbance.kind": 0, "motor_torque": 0.0, **at_rest("_start")}


def free_observer() -> Values:
    """Return start values of an observer beside such an arm."""
    return {"motor_torque": 0.0, **noise_of_the_angles(SMALL_NOISE), **at_rest("_hat_start")}


def two_joints(fmus: Path, values: ParameterSet) -> System:
    """Two arms whose links a spring couples; each observer estimates the torque that comes from the other joint."""
    system = System()
    for joint, turned in TURNED.items():
        start: Values = {**still_plant(), "link_angle_start": turned, "motor_angle_start": turned, **values.plant}
        tuning: Values = {**free_observer(), **values.belief}
        system = system.add(f"plant_{joint}", fmus / "FlexibleJointPlant.fmu", start)
        system = system.add(f"observer_{joint}", fmus / "FlexibleJointObserver.fmu", tuning)
    system = system.add("spring", fmus / "TorsionSpring.fmu", {"stiffness": SPRING})
    for joint in ("a", "b"):
        for angle in MEASURED:
            system = system.connect(f"plant_{joint}.{angle}", f"observer_{joint}.{angle}")
        system = system.connect(f"plant_{joint}.link_angle", f"spring.angle_{joint}")
        system = system.connect(f"spring.torque_{joint}", f"plant_{joint}.load_torque")
    return system


def disturbance_rejection_full(fmus: Path, values: ParameterSet) -> System:
    """The closed loop with a boundary, and with parameters of the arm that are said once for all three who use them."""
    system = (
        disturbance_rejection(fmus, values)
        .expose("reference", "controller.link_angle_reference")
        .expose("compensation", "controller.compensation")
        .expose("link_angle", "plant.link_angle")
        .expose("disturbance_estimate", "observer.load_torque_hat")
    )
    for parameter in ("gravity_torque", "joint_stiffness", "motor_damping"):
        system = system.expose(parameter, *(f"{part}.{parameter}" for part in ("plant", "observer", "controller")))
    return system


def open_loop_boundary(fmus: Path, values: ParameterSet) -> System:
    """The paper's example as one block: torques in, the plant's outputs and their estimates out."""
    torques = {"motor_torque": ("plant.motor_torque", "observer.motor_torque"), "load_torque": ("plant.load_torque",)}
    return with_boundary(open_loop(fmus, values), torques, {})


def disturbance_rejection_boundary(fmus: Path, values: ParameterSet) -> System:
    """The closed loop as one block: the reference of the link's angle in, the loop's signals out."""
    system = disturbance_rejection(fmus, values)
    return with_boundary(system, REFERENCE, {"motor_torque": "controller.motor_torque"})


def noisy_encoder_boundary(fmus: Path, values: ParameterSet) -> System:
    """The loop with noisy encoders as one block: the reference of the link's angle in, the loop's signals out."""
    measured = {f"measured_{angle}": f"{angle}_encoder.measured_angle" for angle in MEASURED}
    system = noisy_encoder(fmus, values)
    return with_boundary(system, REFERENCE, {"motor_torque": "controller.motor_torque", **measured})


def two_joints_boundary(fmus: Path, values: ParameterSet) -> System:
    """The two joints as one block: the motors' torques in, the outputs of both plants and observers out."""
    torques = {f"motor_torque_{j}": (f"plant_{j}.motor_torque", f"observer_{j}.motor_torque") for j in TURNED}
    return with_boundary(
        two_joints(fmus, values), torques, {f"spring_torque_{j}": f"spring.torque_{j}" for j in TURNED}
    )


# (what makes it, stop time in s, its parameter sets)
SYSTEMS: Mapping[str, tuple[Callable[[Path, ParameterSet], System], float, tuple[str, ...]]] = {
    "open_loop": (open_loop, 20.0, ("nominal", "heavy_arm", "detuned")),
    "disturbance_rejection": (disturbance_rejection, 10.0, tuple(SETS)),
    "disturbance_rejection_full": (disturbance_rejection_full, 10.0, ("nominal",)),
    "noisy_encoder": (noisy_encoder, 10.0, tuple(SETS)),
    "two_joints": (two_joints, 10.0, ("nominal", "heavy_arm", "detuned")),
    "open_loop_boundary": (open_loop_boundary, 20.0, ("nominal",)),
    "disturbance_rejection_boundary": (disturbance_rejection_boundary, 10.0, ("nominal",)),
    "noisy_encoder_boundary": (noisy_encoder_boundary, 10.0, ("nominal",)),
    "two_joints_boundary": (two_joints_boundary, 10.0, ("nominal",)),
}


def descriptions(fmus: Path) -> dict[str, bytes]:
    """Return all files by their paths in this folder."""
    files: dict[str, bytes] = {}
    for name, (make, stop_time, sets) in SYSTEMS.items():
        experiment = DefaultExperiment(0.0, stop_time, 1e-3)
        for parameter_set in sets:
            system = make(fmus, SETS[parameter_set])
            texts = description_files(system, name, experiment, parameter_set, " ".join((make.__doc__ or "").split()))
            folder = name if parameter_set == "nominal" else f"{name}/{parameter_set}"
            for file, text in texts.items():
                if parameter_set == "nominal" or file.endswith(".ssv"):
                    files[f"{folder}/{file}"] = text
    plant = {name: value for name, value in still_plant().items() if not name.endswith("angle_start")}
    nested = two_joints_full(plant, free_observer(), SPRING, TURNED)
    return files | {f"two_joints_full/{file}": text for file, text in nested.items()}


def main(fmus: str) -> None:
    """Write the files whose text has changed, and remove those of a system that are no longer made."""
    made = descriptions(Path(fmus))
    for name, data in made.items():
        path = HERE / name
        if not path.is_file() or path.read_bytes() != data:
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(path) as temporary:
                temporary.write_bytes(data)
            print(path)
    for path in HERE.glob("*/**/*.ss?"):
        if path.relative_to(HERE).as_posix() not in made:
            path.unlink()
            print(f"{path}: removed")


if __name__ == "__main__":
    main(*sys.argv[1:])
