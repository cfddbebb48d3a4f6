"""Reading a packaged system description (.ssp, SSP 1.0) as a System.

fmpy reads and checks the structure and the parameter sets; what fmpy passes over in silence is read here or refused.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import ZipFile

from fmpy.ssp.ssd import read_ssd

from ndob_fmu.cosim.archive import open_archive
from ndob_fmu.cosim.component import Value, Variable
from ndob_fmu.cosim.experiment import Experiment
from ndob_fmu.cosim.fmu import FmuComponent
from ndob_fmu.cosim.ssd import SSD_NAME, check_supported, read_connectors, read_experiment
from ndob_fmu.cosim.system import Connection, Port, System
from ndob_fmu.errors import CouplingError, NdobError


@contextmanager
def open_ssp(path: str | Path) -> Iterator[tuple[System, Experiment]]:
    """Give the system in the package and its default experiment; its FMUs lie in a temporary folder until the end.

    Raises UsageError if there is no such file, CouplingError if it is damaged, is incomplete, contradicts itself or
    uses a part of SSP that would not be honoured.
    """
    path = Path(path)
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as folder:
        with open_archive(path) as package:
            root = _parse(path, package)
            check_supported(path, root)
            experiment = read_experiment(path, root)
            structure = _structure(path)
            components = {
                element.name: _component(path, package, element, Path(folder)) for element in structure.elements
            }
        bare = System(components)
        _check_connectors(path, bare, root)
        yield _system(path, bare, structure), experiment


def _parse(path: Path, package: ZipFile) -> ElementTree.Element:
    if SSD_NAME not in package.namelist():
        raise CouplingError.report(str(path), expected=f"a package with {SSD_NAME}", received="one without it")
    try:
        return ElementTree.fromstring(package.read(SSD_NAME))
    except ElementTree.ParseError as error:
        raise CouplingError.report(f"{path}, {SSD_NAME}", expected="well-formed XML", received=str(error)) from error


def _structure(path: Path) -> Any:
    try:
        with path.open("rb") as file:  # given a path, fmpy leaves the file open when it fails
            return read_ssd(file).system
    except Exception as error:  # fmpy raises plain Exception, KeyError for a missing .ssv, and lxml's errors
        # The first line of a failed check is only a heading.
        lines = [line for line in str(error).splitlines() if not line.startswith("Failed to validate")]
        received = lines[0] if lines else repr(error)
        raise CouplingError.report(str(path), expected="files that follow SSP 1.0", received=received) from error


def _component(path: Path, package: ZipFile, element: Any, folder: Path) -> FmuComponent:
    if element.source not in package.namelist():
        fmus = [name for name in package.namelist() if name.endswith(".fmu")]
        raise CouplingError.report(
            f"{path}, component {element.name}",
            expected=f"{element.source} in the package",
            received=", ".join(fmus) or "no FMU",
        )
    return FmuComponent(package.extract(element.source, folder), element.name)


def _check_connectors(path: Path, system: System, root: ElementTree.Element) -> None:
    for connector in read_connectors(root):
        port = Port(connector.component, connector.name)
        variable = system.variable(port)
        for attribute in ("causality", "type", "unit"):
            actual, declared = getattr(variable, attribute), getattr(connector, attribute)
            if actual and declared and actual != declared:
                raise CouplingError.report(
                    f"{path}, connector {port}",
                    expected=f"the {attribute} {actual} of the FMU",
                    received=declared,
                    likely="the FMU was changed after the description was written",
                )


def _system(path: Path, bare: System, structure: Any) -> System:
    connections = tuple(
        Connection(Port(c.startElement, c.startConnector), Port(c.endElement, c.endConnector))
        for c in structure.connections
    )
    # SSP lets a connection be written from either end.
    connections = tuple(
        Connection(c.target, c.source) if bare.variable(c.source).causality == "input" else c for c in connections
    )
    start_values: dict[Port, Value] = {}
    for port, parameter in _parameters(bare, structure):
        if port in start_values:
            raise CouplingError.report(f"{path}, parameter {port}", expected="one value", received="two bindings")
        start_values[port] = _value(path, port, bare.variable(port), parameter)
    return replace(bare, connections=connections, start_values=start_values)


def _parameters(system: System, structure: Any) -> Iterator[tuple[Port, Any]]:
    """Yield what each parameter is for: bare names belong to their component, those of the system are qualified."""
    for element in (structure, *structure.elements):
        for binding in element.parameterBindings:
            for parameter in (p for values in binding.parameterValues for p in values.parameters):
                name = (binding.prefix or "") + parameter.name
                yield (system.port(name) if element is structure else Port(element.name, name)), parameter


def _value(path: Path, port: Port, variable: Variable, parameter: Any) -> Value:
    if parameter.unit and variable.unit and parameter.unit != variable.unit:
        raise _mismatch(path, port, f"the unit {variable.unit}", parameter.unit)
    if (parameter.type == "String") != (variable.type == "String") or parameter.type == "Binary":
        raise _mismatch(path, port, f"a value of type {variable.type}", parameter.type)
    value: Value = parameter.value
    return value


def _mismatch(path: Path, port: Port, expected: str, received: str) -> NdobError:
    return CouplingError.report(f"{path}, parameter {port}", expected=expected, received=received)
