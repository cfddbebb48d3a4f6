"""The connectors of nested systems as one graph: which output leads to which input, and with which scaling."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from ndob_fmu.cosim.component import Variable
from ndob_fmu.cosim.ssp.scaling import Units
from ndob_fmu.cosim.ssp.schema import Element, children, local_name
from ndob_fmu.cosim.system.ports import Connection, Link, Port
from ndob_fmu.errors import CouplingError, some_of
from ndob_fmu.support.units import Unit

INWARDS = ("input", "parameter")
OUTWARDS = ("output", "calculatedParameter")


class Node(NamedTuple):
    """A connector: of a component, of a system ("" is the outermost), or an entry of a signal dictionary."""

    owner: str
    name: str

    def __str__(self) -> str:
        return ".".join(filter(None, self))


class Signal(NamedTuple):
    """The signal at a connector.

    kind: as in SSP.
    type: None where no description states it.
    """

    kind: str
    type: str | None
    unit: Unit


class Hop(NamedTuple):
    """A connection of the description, from a connector to ``target``."""

    target: Node
    factor: float
    offset: float
    convert_units: bool


class End(NamedTuple):
    """A connector that a signal leads to, which receives factor · value + offset."""

    node: Node
    factor: float
    offset: float


def join(*names: str) -> str:
    """Return the name of an element inside a system."""
    return ".".join(filter(None, names))


def components(system: Element, path: str = "") -> Iterator[tuple[str, Element]]:
    """Yield every component, also those of nested systems, with its full name, in the order of the file."""
    for element in children(system, "ssd:Elements/*"):
        name = join(path, element.get("name"))
        if local_name(element) == "System":
            yield from components(element, name)
        elif local_name(element) == "Component":
            yield name, element


@dataclass
class Structure:
    """The graph of all connectors of a description, made by `read_structure`.

    where: the description's name in messages.
    variable: a component's port → what the FMU says of its variable.
    parts: components by full name. units: those that the description defines.
    signals: what the description says of each connector.
    hops: connections by the connector they come from. drivers: target → source.
    """

    where: str
    variable: Callable[[Port], Variable]
    parts: dict[str, Element]
    units: Units
    signals: dict[Node, Signal] = field(default_factory=dict)
    hops: dict[Node, list[Hop]] = field(default_factory=dict)
    drivers: dict[Node, Node] = field(default_factory=dict)

    def connections(self) -> tuple[Connection, ...]:
        """Return what drives what, in the order of the file."""
        found = [
            Connection(Port(*source), Port(*end.node), end.factor, end.offset, convert_units=False)
            for source in self._sources()
            if source.owner in self.parts
            for end in self.ends(source)
            if end.node.owner in self.parts
        ]
        order = {Port(*node): index for index, node in enumerate(self.drivers)}
        return tuple(sorted(found, key=lambda connection: order[connection.target]))

    def inputs(self) -> dict[str, tuple[Link, ...]]:
        """Return the inputs and parameters behind each connector of the outermost system; there may be none."""
        return {
            node.name: tuple(
                Link(Port(*end.node), end.factor, end.offset) for end in self.ends(node) if end.node.owner in self.parts
            )
            for node, signal in self.signals.items()
            if node.owner == "" and signal.kind in INWARDS
        }

    def outputs(self) -> dict[str, Link]:
        """Return the output behind each connector of the outermost system that one leads to."""
        found = {
            end.node.name: Link(Port(*source), end.factor, end.offset)
            for source in self._sources()
            for end in self.ends(source)
            if end.node.owner == ""
        }
        return {name: found[name] for name in self._shown() if name in found}

    def undriven_outputs(self) -> list[str]:
        """Return the outputs of the outermost system that no component's output leads to."""
        found = self.outputs()
        return [name for name in self._shown() if name not in found]

    def _shown(self) -> list[str]:
        return [node.name for node, signal in self.signals.items() if node.owner == "" and signal.kind in OUTWARDS]

    def ends(self, node: Node) -> list[End]:
        """Return where a signal from `node` ends: ports of components and outputs of the outermost system."""
        return list(self._ends(node, self.signal(node).unit, 1.0, 0.0, ()))

    def _ends(self, node: Node, unit: Unit, factor: float, offset: float, trail: tuple[Node, ...]) -> Iterator[End]:
        if node in trail:
            names = some_of(map(str, (*trail, node)), between=" → ")
            raise CouplingError.report(f"{self.where}, {names}", expected="a source", received="a circle of connectors")
        hops = self.hops.get(node, [])
        if trail and not hops and (node.owner in self.parts or node.owner == ""):
            yield End(node, factor, offset)
        for hop in hops:
            scale, shift, after = self._across(node, hop, unit)
            yield from self._ends(hop.target, after, scale * factor, scale * offset + shift, (*trail, node))

    def _across(self, node: Node, hop: Hop, unit: Unit) -> tuple[float, float, Unit]:
        """Return factor and offset of one connection, with the conversion of units, and the unit behind it."""
        source, target = self.signal(node), self.signal(hop.target)
        where = f"{self.where}, connection {node} → {hop.target}"
        if source.type and target.type and source.type != target.type:
            raise CouplingError.report(where, expected=f"the type {target.type} of {hop.target}", received=source.type)
        if not hop.convert_units:
            return hop.factor, hop.offset, target.unit
        scaling = unit.to(target.unit)
        if scaling is None:
            raise CouplingError.report(
                where,
                expected=f"the unit {target.unit} of {hop.target}, or one that converts to it",
                received=str(unit),
            )
        # A connector without unit passes on the one that comes in.
        after = target.unit if target.unit.name else unit
        return hop.factor * scaling[0], hop.factor * scaling[1] + hop.offset, after

    def _sources(self) -> list[Node]:
        """Return the connectors that signals come from: all that drive something and are not driven themselves."""
        return [node for node in self.hops if node not in self.drivers]

    def signal(self, node: Node) -> Signal:
        """Return the signal at a connector; for a component's, the FMU's description takes precedence over the file."""
        declared = self.signals.get(node, Signal("", None, Unit()))
        if node.owner not in self.parts:
            return declared
        variable = self.variable(Port(*node))
        unit = declared.unit
        if variable.unit:
            unit = Unit(variable.unit, variable.base_unit or self.units.get(variable.unit))
        return Signal(variable.causality, variable.type, unit)
