"""Making the XML of a package, with the prefixes that libcosim looks for literally."""

from __future__ import annotations

from lxml import etree

from ndob_fmu.cosim.ssp.schema import NAMESPACES, Element

TOOLS = {
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
}
_PREFIXES = NAMESPACES | TOOLS


def root(name: str, /, *prefixes: str, **attributes: str) -> Element:
    """Return the root of a file that uses these prefixes."""
    return etree.Element(tag(name), attributes, nsmap={prefix: _PREFIXES[prefix] for prefix in prefixes})


def add(parent: Element, name: str, /, **attributes: str) -> Element:
    """Add an element, named with its prefix, and return it."""
    return etree.SubElement(parent, tag(name), attributes)


def tag(name: str) -> str:
    """Return the full name of an element that is named with its prefix."""
    prefix, _, local = name.partition(":")
    return f"{{{_PREFIXES[prefix]}}}{local}"


def annotate(parent: Element, tool: str, *names: str) -> Element:
    """Add an annotation for a tool with elements inside one another, and return the innermost."""
    element = add(add(parent, "ssd:Annotations"), "ssc:Annotation", type=tool)
    for name in names:
        element = add(element, name)
    return element


def file_text(element: Element) -> bytes:
    """Return the file of an element, the same for the same element."""
    etree.indent(element)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + bytes(etree.tostring(element, encoding="UTF-8")) + b"\n"
