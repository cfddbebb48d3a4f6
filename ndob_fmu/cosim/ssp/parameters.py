"""Parameter sets and mappings: which variables each value of a package sets, and to what."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from ndob_fmu.cosim.component import Value
from ndob_fmu.cosim.ssp.scaling import Units, linear, read_units, suppressed, unit_of
from ndob_fmu.cosim.ssp.schema import Element, child, children, local_name
from ndob_fmu.cosim.ssp.structure import End, Node, Structure, join
from ndob_fmu.cosim.ssp.supported import TYPES
from ndob_fmu.cosim.system.ports import Link, Port
from ndob_fmu.cosim.system.system import System
from ndob_fmu.cosim.values import convert
from ndob_fmu.errors import CouplingError, UsageError, one_of
from ndob_fmu.support.units import Unit

# A ParameterBinding or ParameterMapping → the root of what it binds, inside it or in a file of its own.
Source = Callable[[Element], Element]


class _Parameter(NamedTuple):
    """One value of a parameter set; a variable receives factor · value + offset, after a conversion of units."""

    where: str
    name: str
    value: str
    type: str
    unit: Unit
    factor: float = 1.0
    offset: float = 0.0
    convert_units: bool = True


class _Target(NamedTuple):
    """A variable that a parameter sets: it receives factor · value + offset of a value in `unit`."""

    port: Port
    factor: float
    offset: float
    unit: Unit


def start_values(
    system: System, structure: Structure, root_system: Element, source: Source
) -> tuple[dict[Port, Value], dict[str, tuple[Link, ...]]]:
    """Return the start values of a package, and the variables that a name in a mapping of the outermost system sets.

    A later binding replaces an earlier one, and that of a system those inside it, as SSP says. Raises CouplingError
    for an unknown name, and for a value that a variable cannot take.
    """
    starts: dict[Port, Value] = {}
    mapped: dict[str, tuple[Link, ...]] = {}
    for path, element in _inside_out(root_system):
        for binding in children(element, "ssd:ParameterBindings/ssd:ParameterBinding"):
            for original, parameter in _parameters(structure.where, binding, source):
                for target in _targets(system, structure, path, element, parameter.name):
                    scaling = _scaling(parameter, target)
                    starts[target.port] = _value(system, target.port, parameter, scaling)
                    if path == "" and original != parameter.name:
                        mapped[original] = (*mapped.get(original, ()), Link(target.port, *scaling))
    return starts, mapped


def _inside_out(system: Element, path: str = "") -> Iterator[tuple[str, Element]]:
    """Yield every system and component with its full name, what is inside before what is around."""
    for element in children(system, "ssd:Elements/*"):
        name = join(path, element.get("name"))
        if local_name(element) == "System":
            yield from _inside_out(element, name)
        else:
            yield name, element
    yield path, system


def _parameters(where: str, binding: Element, source: Source) -> Iterator[tuple[str, _Parameter]]:
    """Yield the values of a binding, each with the name that it has in its set and the name of what it is for."""
    root = source(binding)
    units = read_units(root)
    prefix = binding.get("prefix") or ""
    found = [_parameter(f"{where}, parameter set {root.get('name')}", entry, prefix, units) for entry in _entries(root)]
    mapping = child(binding, "ssd:ParameterMapping")
    if mapping is None:
        yield from ((parameter.name, parameter) for parameter in found)
        return
    known = {parameter.name: parameter for parameter in found}
    for entry in children(source(mapping), "ssm:MappingEntry"):
        name, target = entry.get("source"), entry.get("target")
        if name not in known:
            raise CouplingError.report(
                f"{where}, mapping to {target}", expected=one_of("parameter", known, name), received=repr(name)
            )
        factor, offset = linear(entry)
        converted = not suppressed(entry)
        yield name, known[name]._replace(name=target, factor=factor, offset=offset, convert_units=converted)


def _entries(root: Element) -> list[Element]:
    return children(root, "ssv:Parameters/ssv:Parameter")


def _parameter(where: str, entry: Element, prefix: str, units: Units) -> _Parameter:
    value = next(part for part in entry.iterchildren("*") if local_name(part) in TYPES)
    name = prefix + entry.get("name")
    return _Parameter(where, name, value.get("value"), local_name(value), unit_of(value, units))


def _targets(system: System, structure: Structure, path: str, element: Element, name: str) -> list[_Target]:
    """Return all variables that a name means in a binding of the element at `path`; raise CouplingError for no name."""
    if local_name(element) == "Component":
        return [_port(system, structure, Port(path, name))]
    full = join(path, name)
    found = [
        _Target(Port(*end.node), end.factor, end.offset, structure.signals[node].unit)
        for node in structure.signals
        if str(node) == full and node.owner not in structure.parts
        for end in _settable(structure, node)
    ]
    for part in structure.parts:
        if full.startswith(f"{part}.") and (path == "" or part.startswith(f"{path}.")):
            port = Port(part, full[len(part) + 1 :])
            if any(variable.name == port.variable for variable in system.component(part).variables):
                found.append(_port(system, structure, port))
    if found or any(str(node) == full and node.owner not in structure.parts for node in structure.signals):
        return found  # a connector of a system may lead nowhere
    return [_port(system, structure, system.port(full))]


def _settable(structure: Structure, node: Node) -> list[End]:
    return [end for end in structure.ends(node) if end.node.owner in structure.parts]


def _port(system: System, structure: Structure, port: Port) -> _Target:
    system.variable(port)  # raises for an unknown name, with the nearest one
    return _Target(port, 1.0, 0.0, structure.signal(Node(*port)).unit)


def _scaling(parameter: _Parameter, target: _Target) -> tuple[float, float]:
    """Return (factor, offset) from the parameter's value to the target's."""
    factor, offset = parameter.factor, parameter.offset
    if parameter.convert_units:
        conversion = parameter.unit.to(target.unit)
        if conversion is None:
            raise CouplingError.report(
                f"{parameter.where}, parameter {target.port}",
                expected=f"the unit {target.unit}, or one that converts to it",
                received=str(parameter.unit),
            )
        factor, offset = factor * conversion[0], factor * conversion[1] + offset
    return target.factor * factor, target.factor * offset + target.offset


def _value(system: System, port: Port, parameter: _Parameter, scaling: tuple[float, float]) -> Value:
    variable, where = system.variable(port), f"{parameter.where}, parameter {port}"
    if (parameter.type == "String") != (variable.type == "String"):
        raise CouplingError.report(where, expected=f"a value of type {variable.type}", received=parameter.type)
    try:
        value = convert(variable, parameter.value, where)
    except UsageError as error:
        raise CouplingError(str(error)) from error  # the fault is in the package, not in the call
    if scaling == (1.0, 0.0):
        return value
    if variable.type != "Real":
        raise CouplingError.report(
            where, expected=f"no factor and no offset for the type {variable.type}", received="a transformation"
        )
    return scaling[0] * float(value) + scaling[1]
