"""The component FMUs that fit any plant, in C."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ndob_fmu.interface.variables import Variable
from ndob_fmu.native.runtime_code import component, part, places
from ndob_fmu.native.sources import ComponentCode

Variables = Sequence[Variable]


def _torsion_spring(variables: Variables) -> ComponentCode:
    wanted = {"blocks.torsion_spring": ["spring_torques"]}
    return component(wanted, [places(variables), part("torsion_spring.c")])


def _sampling(variables: Variables, device: str, resolution: str, *more: str) -> ComponentCode:
    (measured,) = (variable.name for variable in variables if variable.causality == "input")
    defined = {
        "DEVICE": device,
        **{f"DEVICE_{name.upper()}": f"{device}_{name}" for name in ("init", "step", "possible")},
        "AT_MEASURED": f"AT_{measured}",
        "RESOLUTION": resolution,
    }
    wanted = {f"blocks.{device.lower()}": [*(f"{device}.{name}" for name in ("init", "step", "possible")), *more]}
    names = "".join(f"#define {name} {value}\n" for name, value in defined.items())
    return component(
        wanted, [places(variables), part("faults.c"), part("call.c"), part("memory.c"), names, part("sampling.c")]
    )


def _sensor(variables: Variables) -> ComponentCode:
    return _sampling(variables, "Sensor", "values[AT_resolution]")


def _encoder(variables: Variables) -> ComponentCode:
    count = "encoder_angle_of_a_count(&((Core *)call->core)->arena, (int)values[AT_counts_per_revolution])"
    return _sampling(variables, "Encoder", count, "angle_of_a_count")


def _disturbance_source(variables: Variables) -> ComponentCode:
    wanted = {
        "blocks.disturbance_source": ["noise", "Noise.__call__", "Profile.__call__"],
        "blocks.disturbance": ["Generator.__call__"],
        "times": ["same_time"],
    }
    return component(
        wanted, [places(variables), part("faults.c"), part("call.c"), part("memory.c"), part("disturbance_source.c")]
    )


# By the names of `fmu.components.records`.
CODES: Mapping[str, Callable[[Variables], ComponentCode]] = {
    "DisturbanceSource": _disturbance_source,
    "Encoder": _encoder,
    "Sensor": _sensor,
    "TorsionSpring": _torsion_spring,
}
