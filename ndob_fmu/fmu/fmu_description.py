"""What a model description says of an FMU, before any version of FMI gives it a form: variables, units and types."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ndob_fmu.interface.model_variables import METHODS, Variable
from ndob_fmu.runtime.blocks.disturbance import KINDS
from ndob_fmu.runtime.blocks.disturbance_source import INTERPOLATIONS, SOURCE_KINDS
from ndob_fmu.runtime.blocks.sampled_measurement import MISSING
from ndob_fmu.runtime.equations import Experiment

# Modelica's names. A unit that stands for several quantities, like N.m for energy too, has the one that plants mean.
_QUANTITIES = {
    "A": "ElectricCurrent",
    "Hz": "Frequency",
    "K": "Temperature",
    "N": "Force",
    "N.m": "Torque",
    "N.m.s/rad": "RotationalDampingConstant",
    "N.m/rad": "RotationalSpringConstant",
    "N.s/m": "TranslationalDampingConstant",
    "N/m": "TranslationalSpringConstant",
    "Ohm": "Resistance",
    "Pa": "Pressure",
    "V": "Voltage",
    "W": "Power",
    "kg": "Mass",
    "kg.m2": "MomentOfInertia",
    "m": "Length",
    "m/s": "Velocity",
    "m/s2": "Acceleration",
    "m2": "Area",
    "m3": "Volume",
    "m3/s": "VolumeFlowRate",
    "rad": "Angle",
    "rad/s": "AngularVelocity",
    "rad/s2": "AngularAcceleration",
    "s": "Time",
}

_ENUMERATIONS: Mapping[str, Mapping[str, int]] = {
    "DisturbanceKind": KINDS,
    "SourceKind": SOURCE_KINDS,
    "Interpolation": INTERPOLATIONS,
    "MissingSample": MISSING,
    "Method": METHODS,
}
_ITEM_DESCRIPTIONS = {
    "none": "d = 0",
    "constant": "amplitude at all times",
    "ramp": "amplitude times the time since start_time",
    "sine": "amplitude sin(2 pi frequency (t - start_time)) from start_time on",
    "step": "amplitude from start_time on",
    "chirp": "a sine whose frequency rises from 0 to frequency in 10 s and stays there",
    "noise": "Gaussian noise of standard deviation amplitude, flat up to frequency and none above",
    "profile": "the rows of a file",
    "linear": "on the line through the rows",
    "held": "the value before",
    "not_a_number": "NaN, which the observer skips",
    "paper": "the paper's observer, eqs. (22) to (24), integrated inside the step",
    "sampled_data": "the sampled-data design, exact at the communication points",
}


@dataclass(frozen=True)
class FmuDescription:
    """An FMU as its model description shows it.

    name: the model's name and identifier, which is also the name of the FMU's binaries
    text: what the FMU is, in one line
    variables: all variables; the place of one in this list is its value reference
    experiment: the default experiment
    """

    name: str
    text: str
    variables: tuple[Variable, ...]
    experiment: Experiment


@dataclass(frozen=True)
class DeclaredType:
    """A type that variables share: the numbers of one unit, or an enumeration.

    name: as the variables name it
    unit: of its numbers; "" for an enumeration
    quantity: Modelica's name of what the unit measures; "" where it has none here
    items: the enumeration's items, each with its value and what it means
    """

    name: str
    unit: str = ""
    quantity: str = ""
    items: tuple[tuple[str, int, str], ...] = ()


def declared_types(variables: Sequence[Variable]) -> dict[str, DeclaredType]:
    """Return the types of these variables by their `type_key`, in the order in which a description lists them.

    No type has the name of a variable, which FMI forbids.
    """
    taken = {variable.name for variable in variables}
    types: dict[str, DeclaredType] = {}
    for key in sorted({type_key(variable) for variable in variables} - {""}):
        enumeration = _ENUMERATIONS.get(key)
        name = key if enumeration else _QUANTITIES.get(key) or "Unit_" + _as_identifier(key)
        while name in taken:
            name += "_"
        taken.add(name)
        if enumeration:
            items = tuple((item, value, _ITEM_DESCRIPTIONS[item]) for item, value in enumeration.items())
            types[key] = DeclaredType(name, items=items)
        else:
            types[key] = DeclaredType(name, unit=key, quantity=_QUANTITIES.get(key, ""))
    return types


def type_key(variable: Variable) -> str:
    """Return the key of a variable's declared type: its unit or the name of its enumeration; "" for no type."""
    for name, items in _ENUMERATIONS.items():
        if variable.items == items:
            return name
    return variable.unit


def _as_identifier(unit: str) -> str:
    return re.sub(r"\W+", "_", unit.replace("/", "_per_")).strip("_")
