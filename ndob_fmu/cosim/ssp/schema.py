"""Parsing the XML files of a package and checking them against the schemas of SSP 1.0, which fmpy brings along."""

from __future__ import annotations

import functools
from importlib.resources import files
from typing import Any, TypeAlias

from lxml import etree

from ndob_fmu.errors import CouplingError, NdobError

Element: TypeAlias = Any  # lxml carries no type information

SSD_NAME = "SystemStructure.ssd"
SSP = "http://ssp-standard.org/SSP1/SystemStructure"
NAMESPACES = {
    "ssd": f"{SSP}Description",
    "ssc": f"{SSP}Common",
    "ssv": f"{SSP}ParameterValues",
    "ssm": f"{SSP}ParameterMapping",
    "ssb": f"{SSP}SignalDictionary",
}
ROOTS_BY_SUFFIX = {
    ".ssd": "SystemStructureDescription",
    ".ssv": "ParameterSet",
    ".ssm": "ParameterMapping",
    ".ssb": "SignalDictionary",
}
# The schema of a description does not look into the others, which may be inside it.
_ROOTS = {
    "SystemStructureDescription": ("ssd", "Description"),
    "ParameterSet": ("ssv", "ParameterValues"),
    "ParameterMapping": ("ssm", "ParameterMapping"),
    "SignalDictionary": ("ssb", "SignalDictionary"),
}


def parse(where: str, data: bytes, root_name: str) -> Element:
    """Return the root of an XML file, valid by the schema of `root_name`, as are the files inside it.

    Raises CouplingError, with the line, if it is not well-formed or not valid.
    """
    try:
        root = etree.fromstring(data, etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True))
    except etree.XMLSyntaxError as error:
        raise CouplingError.report(where, expected="well-formed XML", received=error.msg or "an empty file") from error
    prefix, _ = _ROOTS[root_name]
    if root.tag != f"{{{NAMESPACES[prefix]}}}{root_name}":
        name, space = local_name(root), etree.QName(root).namespace
        expected = f"{root_name} of {NAMESPACES[prefix]}"
        raise CouplingError.report(where, expected=expected, received=f"{name} of {space or 'no namespace'}")
    if not str(root.get("version", "")).startswith("1."):
        expected, received = f"a {root_name} of version 1.x", f"version {root.get('version')}"
        raise CouplingError.report(where, expected=expected, received=received)
    for element in (root, *_embedded(root)):
        _validate(where, element)
    return root


def _embedded(root: Element) -> list[Element]:
    inside = [f"{{{NAMESPACES[prefix]}}}{name}" for name, (prefix, _) in _ROOTS.items()]
    return [element for element in root.iter(*inside) if element is not root]


def _validate(where: str, element: Element) -> None:
    schema = _schema(local_name(element))
    # An element inside another file is checked as if it were a file of its own, with its own line numbers.
    if not schema.validate(element):
        first = schema.error_log[0]
        text = first.message
        for prefix, namespace in NAMESPACES.items():
            text = text.replace(f"{{{namespace}}}", f"{prefix}:")
        raise invalid(where, f"{text.rstrip('.')} (line {first.line})")


def invalid(where: str, received: str) -> NdobError:
    """Return the error for a file that does not follow the standard."""
    return CouplingError.report(where, expected="a file that follows SSP 1.0", received=received)


@functools.cache
def _schema(root_name: str) -> Any:
    _, name = _ROOTS[root_name]
    folder = files("fmpy") / "ssp" / "schema"
    return etree.XMLSchema(file=str(folder / f"SystemStructure{name}.xsd"))


def local_name(element: Element) -> str:
    """Return the element's name without its namespace."""
    return str(etree.QName(element).localname)


def child(element: Element, path: str) -> Element | None:
    """Return the first element at a path like ``ssd:Connectors/ssd:Connector``, None if there is none."""
    return element.find(path, NAMESPACES)


def children(element: Element, path: str) -> list[Element]:
    """Return all elements at such a path."""
    return list(element.iterfind(path, NAMESPACES))
