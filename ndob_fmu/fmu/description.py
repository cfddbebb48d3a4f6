"""Complete the model description that pythonfmu writes, from the declaration of the variables.

pythonfmu leaves out units, ranges, declared types, initial unknowns and dependencies; without them an FMU fails
validation, and importers see algebraic loops that are not there.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

import pint

from ndob_fmu.errors import ModelError
from ndob_fmu.runtime.interface import Variable

_BASE_UNITS = {
    "kilogram": "kg",
    "meter": "m",
    "second": "s",
    "ampere": "A",
    "kelvin": "K",
    "mole": "mol",
    "candela": "cd",
    "radian": "rad",
}


def complete(root: ET.Element, variables: Sequence[Variable], guid: str) -> ET.Element:
    """Complete the `fmiModelDescription` element in place and return it.

    `guid` replaces pythonfmu's random one and the date is left out, so that the same model gives the same bytes.
    Raises ModelError for a unit that is not one.
    """
    root.set("guid", guid)
    root.attrib.pop("generationDateAndTime", None)
    root.set("generationTool", "ndob-fmu, with " + root.get("generationTool", "PythonFMU"))
    position = list(root).index(_child(root, "LogCategories"))
    for element in (_unit_definitions(variables), _type_definitions(variables)):
        if len(element):
            root.insert(position, element)
            position += 1
    for element, variable in zip(_child(root, "ModelVariables"), variables, strict=True):
        _complete_variable(element, variable)
    structure = _child(root, "ModelStructure")
    structure.clear()
    _list_unknowns(structure, variables)
    ET.indent(root)
    return root


def _complete_variable(element: ET.Element, variable: Variable) -> None:
    typed = element[0]
    if variable.items is not None:
        typed.tag = "Enumeration"
        typed.set("declaredType", _type_name(variable))
    for attribute, value in (
        ("unit", variable.unit or None),
        ("min", variable.minimum),
        ("max", variable.maximum),
        ("nominal", variable.nominal),
    ):
        if value is not None:
            typed.set(attribute, value if isinstance(value, str) else repr(float(value)))


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
        ET.SubElement(unit, "BaseUnit", _base_unit(name))
    return definitions


def _base_unit(name: str) -> dict[str, str]:
    registry: pint.UnitRegistry[float] = pint.UnitRegistry()
    try:
        one, zero = (
            registry.Quantity(value, name.replace(".", "*").replace("^", "**")).to_base_units() for value in (1.0, 0.0)
        )
        attributes = {}
        for base, exponent in one.unit_items():
            attributes[_BASE_UNITS[base]] = f"{exponent:.0f}"
    except (pint.errors.PintError, KeyError, ValueError, AssertionError) as error:
        raise ModelError.report(
            f"unit {name!r}", expected="a unit of physics, like N.m or rad/s", received=f"{name!r} ({error})"
        ) from error
    factor, offset = float(one.magnitude - zero.magnitude), float(zero.magnitude)
    if factor != 1.0:
        attributes["factor"] = repr(factor)
    if offset != 0.0:
        attributes["offset"] = repr(offset)
    return attributes


def _type_definitions(variables: Iterable[Variable]) -> ET.Element:
    definitions = ET.Element("TypeDefinitions")
    written = set()
    for variable in variables:
        name = _type_name(variable)
        if variable.items is None or name in written:
            continue
        written.add(name)
        simple = ET.SubElement(definitions, "SimpleType", {"name": name})
        enumeration = ET.SubElement(simple, "Enumeration")
        for item, value in variable.items.items():
            ET.SubElement(enumeration, "Item", {"name": item, "value": str(value)})
    return definitions


def _type_name(variable: Variable) -> str:
    return "Method" if variable.name == "method" else "DisturbanceKind"


def _child(root: ET.Element, tag: str) -> ET.Element:
    element = root.find(tag)
    if element is None:
        raise LookupError(f"pythonfmu wrote a model description without <{tag}>")
    return element
