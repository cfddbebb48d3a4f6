"""The model description of an FMU for co-simulation as FMI 2.0 writes it (modelDescription.xml)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version

import ndob_fmu
from ndob_fmu.fmu.fmu_description import DeclaredType, FmuDescription, declared_types, log_categories, type_key
from ndob_fmu.interface.variables import Variable
from ndob_fmu.runtime.equations import Experiment
from ndob_fmu.support.units import base_unit

# needsExecutionTool is false although Python must be there: for FMI an execution tool is one that holds the model, and
# this model is inside the FMU. documentation/externalDependencies.txt names Python.
_CAPABILITIES = {
    "needsExecutionTool": "false",
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "modelIdentifier": "",
    "canNotUseMemoryManagementFunctions": "true",
    "maxOutputDerivativeOrder": "0",
    "canRunAsynchronuously": "false",  # as FMI 2.0 spells it
    "providesDirectionalDerivative": "false",
}
_INITIAL = {"output": "calculated", "parameter": "exact"}  # of an input FMI fixes it


def model_description(fmu: FmuDescription, sources: Sequence[str] = ()) -> ET.Element:
    """Return the element `fmiModelDescription` of an FMU, with an empty GUID that the build sets afterwards.

    sources: the C files that a native FMU carries in sources/; without any, PythonFMU runs it

    It names no time, so that the same FMU has the same bytes. Raises ModelError for an invalid unit.
    """
    types = declared_types(fmu.variables)
    attributes = {
        "fmiVersion": "2.0",
        "modelName": fmu.name,
        "guid": "",
        "generationTool": f"ndob-fmu {ndob_fmu.__version__}"
        + ("" if sources else f", with PythonFMU {version('pythonfmu')}"),
        "variableNamingConvention": "structured",
        "description": fmu.text,
    }
    root = ET.Element("fmiModelDescription", attributes)
    cosimulation = ET.SubElement(root, "CoSimulation", _CAPABILITIES | {"modelIdentifier": fmu.name})
    if sources:
        listed = ET.SubElement(cosimulation, "SourceFiles")
        for name in sources:
            ET.SubElement(listed, "File", {"name": name})
    unit_definitions(root, fmu.variables)
    _type_definitions(root, types.values())
    categories = ET.SubElement(root, "LogCategories")
    for name, text in log_categories("fmi2").items():
        ET.SubElement(categories, "Category", {"name": name, "description": text})
    default_experiment(root, fmu.experiment)
    _model_variables(root, fmu.variables, types)
    _model_structure(root, fmu.variables)
    ET.indent(root)
    return root


def unit_definitions(root: ET.Element, variables: Iterable[Variable]) -> None:
    """Add the units of the variables, with what each means in base units; FMI 3 writes them in the same way."""
    names = sorted({variable.unit for variable in variables if variable.unit})
    definitions = ET.SubElement(root, "UnitDefinitions") if names else root
    for name in names:
        unit = ET.SubElement(definitions, "Unit", {"name": name})
        base = base_unit(name)
        if base is not None:
            ET.SubElement(unit, "BaseUnit", base.attributes())


def _type_definitions(root: ET.Element, types: Iterable[DeclaredType]) -> None:
    types = list(types)
    definitions = ET.SubElement(root, "TypeDefinitions") if types else root
    for declared in types:
        simple = ET.SubElement(definitions, "SimpleType", {"name": declared.name})
        if declared.items:
            items = ET.SubElement(simple, "Enumeration")
            for item, value, text in declared.items:
                ET.SubElement(items, "Item", {"name": item, "value": str(value), "description": text})
        else:
            quantity = {"quantity": declared.quantity} if declared.quantity else {}
            ET.SubElement(simple, "Real", quantity | {"unit": declared.unit})


def default_experiment(root: ET.Element, experiment: Experiment) -> None:
    """Add the default experiment; FMI 3 writes it in the same way."""
    times = {"startTime": 0.0, "stopTime": experiment.stop_time, "stepSize": experiment.step_size}
    ET.SubElement(root, "DefaultExperiment", {name: repr(float(time)) for name, time in times.items()})


def _model_variables(root: ET.Element, variables: Iterable[Variable], types: Mapping[str, DeclaredType]) -> None:
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        declared = types.get(type_key(variable))
        scalar = {
            "name": variable.name,
            "valueReference": str(reference),
            "description": variable.description,
            "causality": variable.causality,
            "variability": variable.variability,
            "initial": _INITIAL.get(variable.causality),
        }
        typed = {
            "start": as_text(variable.type, variable.start),
            "declaredType": declared.name if declared else None,
            "unit": variable.unit or None,
            "min": as_text(variable.type, variable.minimum),
            "max": as_text(variable.type, variable.maximum),
            "nominal": as_text(variable.type, variable.nominal),
        }
        element = ET.SubElement(listed, "ScalarVariable", given(scalar))
        ET.SubElement(element, variable.type, given(typed))


def _model_structure(root: ET.Element, variables: Sequence[Variable]) -> None:
    index = {variable.name: i for i, variable in enumerate(variables, start=1)}
    parameters = [index[variable.name] for variable in variables if variable.causality == "parameter"]
    structure = ET.SubElement(root, "ModelStructure")
    listed = ET.SubElement(structure, "Outputs")
    initial = ET.SubElement(structure, "InitialUnknowns")
    for variable in variables:
        if variable.causality != "output":
            continue
        own = str(index[variable.name])
        # Between two steps an output keeps its value from the end of the last step, whatever is set: it has no
        # dependencies, and an importer sees no algebraic loop.
        ET.SubElement(listed, "Unknown", {"index": own, "dependencies": ""})
        known = sorted([*parameters, *(index[name] for name in variable.depends_on)])
        ET.SubElement(initial, "Unknown", {"index": own, "dependencies": " ".join(map(str, known))})


def given(attributes: Mapping[str, str | None]) -> dict[str, str]:
    """Return the attributes that have a value."""
    return {name: value for name, value in attributes.items() if value is not None}


def as_text(kind: str, value: float | int | bool | str | None) -> str | None:
    """Return a value as XML writes it; a Real with all the digits that tell it from its neighbours."""
    if value is None or isinstance(value, str):
        return value
    if kind == "Boolean":
        return str(bool(value)).lower()
    return repr(float(value)) if kind == "Real" else str(int(value))
