"""Complete the model description that pythonfmu writes, from the declaration of the variables.

pythonfmu leaves out units, ranges, declared types, initial unknowns and dependencies; without them an FMU fails
validation, and importers see algebraic loops that are not there.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence

import ndob_fmu
from ndob_fmu.interface.model_variables import METHODS, Variable
from ndob_fmu.runtime.blocks.disturbance import KINDS
from ndob_fmu.runtime.blocks.disturbance_source import INTERPOLATIONS, SOURCE_KINDS
from ndob_fmu.runtime.blocks.sampled_measurement import MISSING
from ndob_fmu.support.units import base_unit

# What an importer can count on, beside what pythonfmu says. A tool that needs an execution tool would be a link to one
# that has the model; here the model is inside, and Python is among the external dependencies.
_CAPABILITIES = {
    "needsExecutionTool": "false",
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "false",
    "maxOutputDerivativeOrder": "0",
    "canRunAsynchronuously": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "false",
}

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


def complete(root: ET.Element, variables: Sequence[Variable]) -> ET.Element:
    """Complete the `fmiModelDescription` element in place and return it.

    pythonfmu's random GUID and the date are left out, so that the same model gives the same bytes; the build sets its
    own GUID afterwards. Raises ModelError for a unit that is not one.
    """
    root.set("guid", "")
    root.attrib.pop("generationDateAndTime", None)
    tool = root.get("generationTool", "PythonFMU")
    root.set("generationTool", f"ndob-fmu {ndob_fmu.__version__}, with {tool}")
    _child(root, "CoSimulation").attrib.update(_CAPABILITIES)
    type_names = _type_names(variables)
    position = list(root).index(_child(root, "LogCategories"))
    for element in (_unit_definitions(variables), _type_definitions(type_names)):
        if len(element):
            root.insert(position, element)
            position += 1
    for element, variable in zip(_child(root, "ModelVariables"), variables, strict=True):
        _complete_variable(element, variable, type_names)
    structure = _child(root, "ModelStructure")
    structure.clear()
    _list_unknowns(structure, variables)
    ET.indent(root)
    return root


def _complete_variable(element: ET.Element, variable: Variable, type_names: Mapping[str, str]) -> None:
    typed = element[0]
    if variable.items is not None:
        typed.tag = "Enumeration"
    # pythonfmu writes 16 digits, and with them another number than the FMU starts with.
    start = variable.start if isinstance(variable.start, float) and "start" in typed.attrib else None
    for attribute, value in (
        ("declaredType", type_names.get(_type_key(variable))),
        ("start", start),
        ("unit", variable.unit or None),
        ("min", variable.minimum),
        ("max", variable.maximum),
        ("nominal", variable.nominal),
    ):
        if value is not None:
            typed.set(attribute, value if isinstance(value, str) else repr(value))


def _list_unknowns(structure: ET.Element, variables: Sequence[Variable]) -> None:
    index = {variable.name: i for i, variable in enumerate(variables, start=1)}
    outputs = [variable for variable in variables if variable.causality == "output"]
    parameters = [index[variable.name] for variable in variables if variable.causality == "parameter"]
    listed = ET.SubElement(structure, "Outputs")
    initial = ET.SubElement(structure, "InitialUnknowns")
    for variable in outputs:
        own = str(index[variable.name])
        # Between steps an output shows the end of the last step: nothing that is set then reaches it at once.
        ET.SubElement(listed, "Unknown", {"index": own, "dependencies": ""})
        known = sorted([*parameters, *(index[name] for name in variable.depends_on)])
        ET.SubElement(initial, "Unknown", {"index": own, "dependencies": " ".join(map(str, known))})


def _unit_definitions(variables: Iterable[Variable]) -> ET.Element:
    definitions = ET.Element("UnitDefinitions")
    for name in sorted({variable.unit for variable in variables if variable.unit}):
        unit = ET.SubElement(definitions, "Unit", {"name": name})
        base = base_unit(name)
        if base is not None:
            ET.SubElement(unit, "BaseUnit", base.attributes())
    return definitions


def _type_definitions(type_names: Mapping[str, str]) -> ET.Element:
    definitions = ET.Element("TypeDefinitions")
    for key, name in type_names.items():
        simple = ET.SubElement(definitions, "SimpleType", {"name": name})
        if key in _ENUMERATIONS:
            items = ET.SubElement(simple, "Enumeration")
            for item, value in _ENUMERATIONS[key].items():
                text = _ITEM_DESCRIPTIONS[item]
                ET.SubElement(items, "Item", {"name": item, "value": str(value), "description": text})
        else:
            quantity = {"quantity": _QUANTITIES[key]} if key in _QUANTITIES else {}
            ET.SubElement(simple, "Real", quantity | {"unit": key})
    return definitions


def _type_names(variables: Sequence[Variable]) -> dict[str, str]:
    """Return the name of the type of every unit and enumeration in use; none is also the name of a variable."""
    taken = {variable.name for variable in variables}
    names: dict[str, str] = {}
    for key in sorted({_type_key(variable) for variable in variables} - {""}):
        name = key if key in _ENUMERATIONS else _QUANTITIES.get(key) or "Unit_" + _as_identifier(key)
        while name in taken:
            name += "_"
        taken.add(name)
        names[key] = name
    return names


def _type_key(variable: Variable) -> str:
    """Return what a variable's declared type goes by: its unit, or the name of its enumeration; "" for no type."""
    for name, items in _ENUMERATIONS.items():
        if variable.items == items:
            return name
    return variable.unit


def _as_identifier(unit: str) -> str:
    return re.sub(r"\W+", "_", unit.replace("/", "_per_")).strip("_")


def _child(root: ET.Element, tag: str) -> ET.Element:
    element = root.find(tag)
    if element is None:
        raise LookupError(f"pythonfmu wrote a model description without <{tag}>")
    return element
