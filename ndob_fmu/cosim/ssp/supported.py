"""The parts of SSP that a run supports. A file with any other part is refused before anything is unpacked."""

from __future__ import annotations

from ndob_fmu.cosim.ssp.schema import Element, local_name
from ndob_fmu.errors import CouplingError, NdobError

TYPES = {"Real", "Integer", "Boolean", "String", "Enumeration"}
FMU_TYPE = "application/x-fmu-sharedlibrary"

# Geometry says how a system is drawn. Annotations are for the tool that they name; only step sizes of OSP are read.
_WITHOUT_EFFECT = {
    "Annotations",
    "ConnectionGeometry",
    "ConnectorGeometry",
    "ElementGeometry",
    "GraphicalElements",
    "SystemGeometry",
}
_LINEAR = {"LinearTransformation"}

# For each element, the child elements that are supported; others are refused.
_SUPPORTED = {
    "SystemStructureDescription": {"System", "Units", "Enumerations", "DefaultExperiment"},
    "System": {"Elements", "Connections", "Connectors", "ParameterBindings", "SignalDictionaries"},
    "Elements": {"Component", "System", "SignalDictionaryReference"},
    "Component": {"Connectors", "ParameterBindings"},
    "SignalDictionaryReference": {"Connectors"},
    "SignalDictionaries": {"SignalDictionary"},
    "SignalDictionary": {"SignalDictionary", "DictionaryEntry", "Units", "Enumerations"},
    "DictionaryEntry": TYPES,
    "Connectors": {"Connector"},
    "Connector": TYPES,
    "ParameterBindings": {"ParameterBinding"},
    "ParameterBinding": {"ParameterValues", "ParameterMapping"},
    "ParameterValues": {"ParameterSet"},
    "ParameterSet": {"Parameters", "Units", "Enumerations"},
    "Parameters": {"Parameter"},
    "Parameter": TYPES,
    "ParameterMapping": {"ParameterMapping", "MappingEntry"},
    "MappingEntry": _LINEAR,
    "Connections": {"Connection"},
    "Connection": _LINEAR,
    "DefaultExperiment": set[str](),
}

# Attributes whose value changes the meaning: (element, attribute) → the values that are supported.
_ATTRIBUTES = {
    ("Component", "type"): {FMU_TYPE},
    ("Component", "implementation"): {"any", "CoSimulation"},
    ("ParameterBinding", "type"): {"application/x-ssp-parameter-set"},
    ("ParameterBinding", "sourceBase"): {"SSD"},
    ("ParameterMapping", "type"): {"application/x-ssp-parameter-mapping"},
    ("ParameterMapping", "sourceBase"): {"SSD"},
    ("SignalDictionary", "type"): {"application/x-ssp-signal-dictionary"},
}


def check_supported(where: str, element: Element) -> None:
    """Raise CouplingError, naming it, for the first part of a file that a run does not support."""
    tag = local_name(element)
    for (owner, attribute), allowed in _ATTRIBUTES.items():
        value = element.get(attribute)
        if owner == tag and value is not None and value not in allowed:
            raise _refusal(where, f"{attribute}={value!r} of {label(element)}")
    if tag not in _SUPPORTED:
        return
    for part in element.iterchildren("*"):
        name = local_name(part)
        if name in _WITHOUT_EFFECT:
            continue
        if name not in _SUPPORTED[tag]:
            raise _refusal(where, f"{name} in {label(element)}")
        check_supported(where, part)


def label(element: Element) -> str:
    """Return the element's name in messages."""
    tag = local_name(element)
    if tag == "Connection":
        ends = [
            ".".join(filter(None, (element.get(f"{end}Element"), element.get(f"{end}Connector"))))
            for end in ("start", "end")
        ]
        return f"connection {' → '.join(ends)}"
    return f"{tag} {element.get('name')!r}" if element.get("name") else tag


def _refusal(where: str, found: str) -> NdobError:
    return CouplingError.report(
        where,
        expected="FMUs for co-simulation, their parameters, and connections with at most a linear transformation",
        received=found,
        likely="the package was made for a tool that supports more of SSP",
    )
