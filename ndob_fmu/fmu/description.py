"""Complete the model description that pythonfmu writes, from the declaration of the variables.

pythonfmu leaves out units, ranges, declared types, initial unknowns and dependencies; without them an FMU fails
validation, and importers see algebraic loops that are not there.
"""

from __future__ import annotations

import functools
import re
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


def complete(root: ET.Element, variables: Sequence[Variable]) -> ET.Element:
    """Complete the `fmiModelDescription` element in place and return it.

    pythonfmu's random GUID and the date are left out, so that the same model gives the same bytes; the build sets its
    own GUID afterwards. Raises ModelError for a unit that is not one.
    """
    root.set("guid", "")
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
        base = _base_unit(name)
        if base is not None:
            ET.SubElement(unit, "BaseUnit", base)
    return definitions


@functools.cache
def _registry() -> pint.UnitRegistry[float]:
    registry: pint.UnitRegistry[float] = pint.UnitRegistry()  # a third of a second each
    registry.define("@alias ohm = Ohm")
    return registry


def _base_unit(name: str) -> dict[str, str] | None:
    """Return the attributes of FMI's BaseUnit; None for a broken power like cm2.5, for which FMI has no form."""
    # As in Modelica a dot multiplies and a power follows its unit at once: kg.m2/s2.
    formula = re.sub(r"(?<=[A-Za-z])\^?(-?\d+(?:\.\d+)?)", r"**(\1)", name)
    formula = re.sub(r"\.(?!\d)", "*", formula)
    try:
        one, zero = (_registry().Quantity(value, formula).to_base_units() for value in (1.0, 0.0))
        powers = {_BASE_UNITS[base]: complex(power).real for base, power in one.unit_items()}
    except Exception as error:  # for a text that is no formula pint raises more than its own errors
        raise ModelError.report(
            f"unit {name!r}",
            expected="a unit of physics, like N.m, rad/s or kg.m2",
            received=f"{name!r} ({' '.join(str(error).split())})",
        ) from error
    if not all(power.is_integer() for power in powers.values()):
        return None
    attributes = {base: str(int(power)) for base, power in powers.items()}
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
