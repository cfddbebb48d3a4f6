"""Packages for tests, of a few lines of XML and the gains of `coupling_slaves`: y = k (a + b)."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

SSP = "http://ssp-standard.org/SSP1/SystemStructure"
SPACES = " ".join(
    f'xmlns:{prefix}="{SSP}{name}"'
    for prefix, name in {
        "ssd": "Description",
        "ssc": "Common",
        "ssv": "ParameterValues",
        "ssm": "ParameterMapping",
        "ssb": "SignalDictionary",
    }.items()
)
OSP = 'xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations"'


def description(system: str, after: str = "") -> str:
    """The inside of the outermost system as a file, with units or an experiment after it."""
    head = f'<ssd:SystemStructureDescription version="1.0" name="test" {SPACES} {OSP}>'
    return f'{head}<ssd:System name="test">{system}</ssd:System>{after}</ssd:SystemStructureDescription>'


def component(name: str, connectors: str = "", *, bindings: str = "", source: str = "Gain.fmu", after: str = "") -> str:
    """connectors: like ``a>`` for an input, ``y<`` for an output, ``k=`` for a parameter."""
    bound = f"<ssd:ParameterBindings>{bindings}</ssd:ParameterBindings>" if bindings else ""
    return f'<ssd:Component name="{name}" source="{source}">{ports(connectors)}{bound}{after}</ssd:Component>'


def ports(connectors: str) -> str:
    """Connectors of a component or a system; a unit follows in brackets: ``angle>[deg]``."""
    kinds = {">": "input", "<": "output", "=": "parameter"}
    found = re.findall(r"(\w+)([<>=])(?:\[(.+?)\])?", connectors)
    lines = []
    for name, mark, unit_name in found:
        real = f'<ssc:Real unit="{unit_name}"/>' if unit_name else "<ssc:Real/>"
        lines.append(f'<ssd:Connector name="{name}" kind="{kinds[mark]}">{real}</ssd:Connector>')
    return f"<ssd:Connectors>{''.join(lines)}</ssd:Connectors>" if lines else ""


def elements(*parts: str) -> str:
    return f"<ssd:Elements>{''.join(parts)}</ssd:Elements>"


def connections(*pairs: str) -> str:
    """Each like ``one.y a.b``; a part without a dot is a connector of the system; what follows goes inside."""
    return f"<ssd:Connections>{''.join(map(_connection, pairs))}</ssd:Connections>"


def _connection(pair: str) -> str:
    start, end, *inside = pair.split(" ", 2)
    ends = ""
    for side, port in (("start", start), ("end", end)):
        element, _, connector = port.rpartition(".")
        ends += f' {side}Element="{element}"' * bool(element) + f' {side}Connector="{connector}"'
    text = "".join(inside)
    if text.startswith("suppress"):
        ends, text = f'{ends} suppressUnitConversion="true"', text.removeprefix("suppress")
    return f"<ssd:Connection{ends}>{text}</ssd:Connection>"


def linear(factor: float, offset: float = 0.0) -> str:
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def values(*, mapping: str = "", prefix: str = "", units: str = "", **parameters: float | str) -> str:
    """A binding with its values inside; a value may be ``180 deg``."""
    lines = []
    for name, value in parameters.items():
        number, _, unit = str(value).partition(" ")
        real = f'<ssv:Real value="{number}"{f" unit={unit!r}" if unit else ""}/>'
        lines.append(f'<ssv:Parameter name="{name}">{real}</ssv:Parameter>')
    inside = f"<ssv:Parameters>{''.join(lines)}</ssv:Parameters>{units}"
    parameter_set = f'<ssv:ParameterSet version="1.0" name="set">{inside}</ssv:ParameterSet>'
    start = f'<ssd:ParameterBinding prefix="{prefix}">' if prefix else "<ssd:ParameterBinding>"
    return f"{start}<ssd:ParameterValues>{parameter_set}</ssd:ParameterValues>{mapping}</ssd:ParameterBinding>"


def bindings(*texts: str) -> str:
    return f"<ssd:ParameterBindings>{''.join(texts)}</ssd:ParameterBindings>"


def mapping(*entries: str) -> str:
    """Each like ``source target``; what follows goes inside."""
    lines = []
    for entry in entries:
        source, target, *inside = entry.split(" ", 2)
        lines.append(f'<ssm:MappingEntry source="{source}" target="{target}">{"".join(inside)}</ssm:MappingEntry>')
    return f'<ssm:ParameterMapping version="1.0" {SPACES}>{"".join(lines)}</ssm:ParameterMapping>'


def unit(name: str, *, prefix: str = "ssd", **base: float) -> str:
    powers = " ".join(f'{key}="{value}"' for key, value in base.items())
    return f'<{prefix}:Units><ssc:Unit name="{name}"><ssc:BaseUnit {powers}/></ssc:Unit></{prefix}:Units>'


def changed(source: Path, target: Path, **units: str) -> Path:
    """Copy an FMU with units in its model description."""
    with zipfile.ZipFile(source) as before, zipfile.ZipFile(target, "w") as after:
        for name in before.namelist():
            data = before.read(name)
            if name == "modelDescription.xml":
                for variable, text in units.items():
                    found = f'(?s)(name="{variable}".*?<Real)'.encode()
                    data = re.sub(found, rf'\1 unit="{text}"'.encode(), data, count=1)
            after.writestr(name, data)
    return target
