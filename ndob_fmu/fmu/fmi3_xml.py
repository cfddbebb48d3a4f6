"""The model description of a native FMU as FMI 3.0 writes it, and what it says of its sources."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence

import ndob_fmu
from ndob_fmu.fmu.fmi2_xml import as_text, default_experiment, given, unit_definitions
from ndob_fmu.fmu.fmu_description import DeclaredType, FmuDescription, declared_types, log_categories, type_key
from ndob_fmu.interface.variables import Variable

_CAPABILITIES = {
    "needsExecutionTool": "false",
    "canHandleVariableCommunicationStepSize": "true",
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
}
_TYPES = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "String": "String", "Enumeration": "Enumeration"}


def model_description(fmu: FmuDescription) -> ET.Element:
    """Return the element `fmiModelDescription`, with an empty instantiationToken that the build sets afterwards.

    Raises ModelError for an invalid unit.
    """
    types = declared_types(fmu.variables)
    attributes = {
        "fmiVersion": "3.0",
        "modelName": fmu.name,
        "instantiationToken": "",
        "generationTool": f"ndob-fmu {ndob_fmu.__version__}",
        "variableNamingConvention": "structured",
        "description": fmu.text,
    }
    root = ET.Element("fmiModelDescription", attributes)
    ET.SubElement(root, "CoSimulation", {"modelIdentifier": fmu.name} | _CAPABILITIES)
    unit_definitions(root, fmu.variables)
    _type_definitions(root, types.values())
    categories = ET.SubElement(root, "LogCategories")
    for name, text in log_categories("fmi3").items():
        ET.SubElement(categories, "Category", {"name": name, "description": text})
    default_experiment(root, fmu.experiment)
    _model_variables(root, fmu.variables, types)
    _model_structure(root, fmu.variables)
    ET.indent(root)
    return root


def build_description(fmu: FmuDescription, sources: Sequence[str]) -> ET.Element:
    """Return the element `fmiBuildDescription` for the C files in sources/."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": fmu.name})
    files = ET.SubElement(configuration, "SourceFileSet", {"language": "C99"})
    for name in sources:
        ET.SubElement(files, "SourceFile", {"name": name})
    ET.indent(root)
    return root


def _type_definitions(root: ET.Element, types: Iterable[DeclaredType]) -> None:
    types = list(types)
    definitions = ET.SubElement(root, "TypeDefinitions") if types else root
    for declared in types:
        if declared.items:
            items = ET.SubElement(definitions, "EnumerationType", {"name": declared.name})
            for item, value, text in declared.items:
                ET.SubElement(items, "Item", {"name": item, "value": str(value), "description": text})
        else:
            quantity = {"quantity": declared.quantity} if declared.quantity else {}
            ET.SubElement(definitions, "Float64Type", {"name": declared.name} | quantity | {"unit": declared.unit})


def _model_variables(root: ET.Element, variables: Sequence[Variable], types: Mapping[str, DeclaredType]) -> None:
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        declared = types.get(type_key(variable))
        start = as_text(variable.type, variable.start)
        attributes = {
            "name": variable.name,
            "valueReference": str(reference),
            "description": variable.description,
            "causality": variable.causality,
            "variability": variable.variability,
            "initial": "exact" if variable.causality == "parameter" else None,
            "declaredType": declared.name if declared else None,
            "unit": variable.unit or None,
            "min": as_text(variable.type, variable.minimum),
            "max": as_text(variable.type, variable.maximum),
            "nominal": as_text(variable.type, variable.nominal),
            "start": None if variable.type == "String" else start,
        }
        element = ET.SubElement(listed, _TYPES[variable.type], given(attributes))
        if variable.type == "String" and start is not None:
            ET.SubElement(element, "Start", {"value": start})
    time = {
        "name": "time",
        "valueReference": str(len(variables)),
        "description": "The end of the last step",
        "causality": "independent",
        "variability": "continuous",
        "unit": "s",
    }
    if any(variable.unit == "s" for variable in variables):
        ET.SubElement(listed, "Float64", time)
    else:
        ET.SubElement(listed, "Float64", {name: text for name, text in time.items() if name != "unit"})


def _model_structure(root: ET.Element, variables: Sequence[Variable]) -> None:
    reference = {variable.name: i for i, variable in enumerate(variables)}
    parameters = [reference[variable.name] for variable in variables if variable.causality == "parameter"]
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [variable for variable in variables if variable.causality == "output"]
    for variable in outputs:  # no dependencies between two steps, as in FMI 2
        ET.SubElement(structure, "Output", {"valueReference": str(reference[variable.name]), "dependencies": ""})
    for variable in outputs:
        known = sorted([*parameters, *(reference[name] for name in variable.depends_on)])
        attributes = {
            "valueReference": str(reference[variable.name]),
            "dependencies": " ".join(map(str, known)),
        }
        ET.SubElement(structure, "InitialUnknown", attributes)
