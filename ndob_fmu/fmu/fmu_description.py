"""What a model description says of an FMU, before any version of FMI gives it a form: variables, units and types."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ndob_fmu.interface.variables import Variable
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

_STATUSES = ("Warning", "Discard", "Error", "Fatal")


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


def log_categories(prefix: str) -> dict[str, str]:
    """Return the log categories with what each holds, where the statuses begin with `prefix`."""
    statuses = {f"logStatus{name}": f"Log messages with {prefix}{name} status." for name in _STATUSES}
    return statuses | {"logAll": "Log all messages."}


def declared_types(variables: Sequence[Variable]) -> dict[str, DeclaredType]:
    """Return the types of these variables by their `type_key`, in the order in which a description lists them.

    No type has the name of a variable, which FMI forbids.
    """
    taken = {variable.name for variable in variables}
    enumerations = {variable.enumeration.name: variable.enumeration for variable in variables if variable.enumeration}
    types: dict[str, DeclaredType] = {}
    for key in sorted({type_key(variable) for variable in variables} - {""}):
        enumeration = enumerations.get(key)
        name = key if enumeration else _QUANTITIES.get(key) or "Unit_" + _as_identifier(key)
        while name in taken:
            name += "_"
        taken.add(name)
        if enumeration:
            items = tuple((item, value, enumeration.texts[item]) for item, value in enumeration.items.items())
            types[key] = DeclaredType(name, items=items)
        else:
            types[key] = DeclaredType(name, unit=key, quantity=_QUANTITIES.get(key, ""))
    return types


def type_key(variable: Variable) -> str:
    """Return the key of a variable's declared type: its unit or the name of its enumeration; "" for no type."""
    return variable.enumeration.name if variable.enumeration else variable.unit


def _as_identifier(unit: str) -> str:
    return re.sub(r"\W+", "_", unit.replace("/", "_per_")).strip("_")
