"""The parts of a SystemStructure.ssd that fmpy does not read: what is not supported, and the default experiment."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from ndob_fmu.cosim.experiment import Experiment
from ndob_fmu.errors import CouplingError

SSD_NAME = "SystemStructure.ssd"
_FMU_TYPE = "application/x-fmu-sharedlibrary"
_OSP = "com.opensimulationplatform"
_TYPES = {"Real", "Integer", "Boolean", "String", "Enumeration"}

# Geometry says how a system is drawn. Annotations are for the tool that they name; only OSP's step size is read.
_WITHOUT_EFFECT = {
    "Annotations",
    "ConnectionGeometry",
    "ConnectorGeometry",
    "ElementGeometry",
    "GraphicalElements",
    "SystemGeometry",
}

# For each element those inside it that are honoured; whatever is missing here is refused by name.
_HONOURED = {
    "SystemStructureDescription": {"System", "Units", "Enumerations", "DefaultExperiment"},
    "System": {"Elements", "Connections", "ParameterBindings"},
    "Elements": {"Component"},
    "Component": {"Connectors", "ParameterBindings"},
    "Connectors": {"Connector"},
    "Connector": _TYPES,
    "ParameterBindings": {"ParameterBinding"},
    "ParameterBinding": {"ParameterValues"},
    "ParameterValues": {"ParameterSet"},
    "ParameterSet": {"Parameters", "Units", "Enumerations"},
    "Connections": {"Connection"},
    "Connection": set[str](),
    "DefaultExperiment": set[str](),
}
_NAMES = {
    ("Elements", "System"): "a nested system",
    ("Elements", "SignalDictionaryReference"): "a signal dictionary",
    ("System", "SignalDictionaries"): "a signal dictionary",
    ("System", "Connectors"): "a connector at the system's boundary",
    ("ParameterBinding", "ParameterMapping"): "a parameter mapping (.ssm)",
}

# Attributes whose values would change the meaning: (element, attribute) → the values that are honoured.
_ATTRIBUTES = {
    ("Component", "type"): {_FMU_TYPE},
    ("Component", "implementation"): {"any", "CoSimulation"},
    ("Connection", "suppressUnitConversion"): {"false", "0"},
    ("ParameterBinding", "type"): {"application/x-ssp-parameter-set"},
    ("ParameterBinding", "sourceBase"): {"SSD"},
}


def local_name(element: Element) -> str:
    """Return the element's name without its namespace."""
    return element.tag.rpartition("}")[2]


def check_supported(path: Path, root: Element) -> None:
    """Raise CouplingError, naming it, for the first part of the description that a run would not honour."""
    if local_name(root) != "SystemStructureDescription" or not (root.get("version") or "").startswith("1."):
        received = f"{local_name(root)} of version {root.get('version')}"
        expected = "SystemStructureDescription of version 1.x"
        raise CouplingError.report(f"{path}, {SSD_NAME}", expected=expected, received=received)
    _check(path, root)


def _check(path: Path, element: Element) -> None:
    tag = local_name(element)
    for (owner, attribute), allowed in _ATTRIBUTES.items():
        value = element.get(attribute)
        if owner == tag and value is not None and value not in allowed:
            _refuse(path, f"{attribute}={value!r} of {_label(element)}")
    for end in ("startElement", "endElement"):
        if tag == "Connection" and element.get(end) is None:
            _refuse(path, f"a connection to the system's boundary (no {end})")
    if tag not in _HONOURED:
        return
    for child in element:
        name = local_name(child)
        if name in _WITHOUT_EFFECT:
            continue
        if name not in _HONOURED[tag]:
            _refuse(path, f"{_NAMES.get((tag, name), name)} in {_label(element)}")
        _check(path, child)


def _label(element: Element) -> str:
    tag = local_name(element)
    if tag == "Connection":
        ends = [f"{element.get(f'{end}Element')}.{element.get(f'{end}Connector')}" for end in ("start", "end")]
        return f"connection {' → '.join(ends)}"
    return f"{tag} {element.get('name')!r}" if element.get("name") else tag


def _refuse(path: Path, found: str) -> None:
    raise CouplingError.report(
        f"{path}, {SSD_NAME}",
        expected="one flat system of FMUs with plain connections and parameter values",
        received=found,
        likely="the package was made for a tool that supports more of SSP",
    )


@dataclass(frozen=True)
class Connector:
    """What the description says of a component's variable; None where it says nothing."""

    component: str
    name: str
    causality: str
    type: str | None
    unit: str | None


def read_connectors(root: Element) -> list[Connector]:
    """Return the connectors of all components of a description that ``check_supported`` has accepted."""
    found = []
    for component in (element for element in root.iter() if local_name(element) == "Component"):
        for entry in (element for element in component.iter() if local_name(element) == "Connector"):
            kind = next((child for child in entry if local_name(child) in _TYPES), None)
            found.append(
                Connector(
                    component.get("name", ""),
                    entry.get("name", ""),
                    entry.get("kind", ""),
                    None if kind is None else local_name(kind),
                    None if kind is None else kind.get("unit"),
                )
            )
    return found


def read_experiment(path: Path, root: Element) -> Experiment:
    """Return start and stop time, and the step size from the annotation of the Open Simulation Platform.

    Raises CouplingError if one of them is not a finite number.
    """
    experiment = next((child for child in root if local_name(child) == "DefaultExperiment"), None)
    if experiment is None:
        return Experiment()
    algorithms = [
        algorithm
        for annotation in experiment.iter()
        if local_name(annotation) == "Annotation" and annotation.get("type") == _OSP
        for algorithm in annotation.iter()
        if local_name(algorithm) == "FixedStepAlgorithm"
    ]
    return Experiment(
        _seconds(path, experiment, "startTime"),
        _seconds(path, experiment, "stopTime"),
        _seconds(path, algorithms[0], "baseStepSize") if algorithms else None,
    )


def _seconds(path: Path, element: Element, attribute: str) -> float | None:
    text = element.get(attribute)
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CouplingError.report(f"{path}, {attribute}", expected="a finite number of seconds", received=repr(text))
    return value
