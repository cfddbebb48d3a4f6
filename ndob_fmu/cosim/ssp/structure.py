"""Nested systems made flat: which component's output gets to which input, and through which scaling on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from ndob_fmu.cosim.component import Variable
from ndob_fmu.cosim.ssp.scaling import Units, linear, suppressed, unit_of
from ndob_fmu.cosim.ssp.schema import Element, children, local_name
from ndob_fmu.cosim.ssp.supported import TYPES, label
from ndob_fmu.cosim.system.ports import Connection, Link, Port
from ndob_fmu.errors import CouplingError, NdobError, one_of, some_of
from ndob_fmu.support.units import Unit

_INWARDS = ("input", "parameter")
_OUTWARDS = ("output", "calculatedParameter")


class Node(NamedTuple):
    """A connector: of a component, of a system ("" is the outermost), or an entry of a signal dictionary."""

    owner: str
    name: str

    def __str__(self) -> str:
        return ".".join(filter(None, self))


class Signal(NamedTuple):
    """What is known of the values at a connector; kind as in SSP, type None where nothing says it."""

    kind: str
    type: str | None
    unit: Unit


class _Hop(NamedTuple):
    target: Node
    factor: float
    offset: float
    convert_units: bool


class End(NamedTuple):
    """Where a signal gets to, which receives factor · value + offset."""

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
    """The graph of all connectors of a description, made by `read_structure`."""

    where: str
    variable: Callable[[Port], Variable]
    parts: dict[str, Element]
    units: Units
    signals: dict[Node, Signal] = field(default_factory=dict)
    _hops: dict[Node, list[_Hop]] = field(default_factory=dict)
    _drivers: dict[Node, Node] = field(default_factory=dict)

    def connections(self) -> tuple[Connection, ...]:
        """Return what drives what, in the order of the file."""
        found = [
            Connection(Port(*source), Port(*end.node), end.factor, end.offset, convert_units=False)
            for source in self._sources()
            if source.owner in self.parts
            for end in self.ends(source)
            if end.node.owner in self.parts
        ]
        order = {Port(*node): index for index, node in enumerate(self._drivers)}
        return tuple(sorted(found, key=lambda connection: order[connection.target]))

    def inputs(self) -> dict[str, tuple[Link, ...]]:
        """Return the inputs and parameters behind each connector of the outermost system; there may be none."""
        return {
            node.name: tuple(
                Link(Port(*end.node), end.factor, end.offset) for end in self.ends(node) if end.node.owner in self.parts
            )
            for node, signal in self.signals.items()
            if node.owner == "" and signal.kind in _INWARDS
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
        return [node.name for node, signal in self.signals.items() if node.owner == "" and signal.kind in _OUTWARDS]

    def ends(self, node: Node) -> list[End]:
        """Return where a signal from `node` gets to: ports of components and outputs of the outermost system."""
        return list(self._ends(node, self.signal(node).unit, 1.0, 0.0, ()))

    def _ends(self, node: Node, unit: Unit, factor: float, offset: float, trail: tuple[Node, ...]) -> Iterator[End]:
        if node in trail:
            names = some_of(map(str, (*trail, node)), between=" → ")
            raise CouplingError.report(f"{self.where}, {names}", expected="a source", received="a circle of connectors")
        hops = self._hops.get(node, [])
        if trail and not hops and (node.owner in self.parts or node.owner == ""):
            yield End(node, factor, offset)
        for hop in hops:
            scale, shift, after = self._across(node, hop, unit)
            yield from self._ends(hop.target, after, scale * factor, scale * offset + shift, (*trail, node))

    def _across(self, node: Node, hop: _Hop, unit: Unit) -> tuple[float, float, Unit]:
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
        return [node for node in self._hops if node not in self._drivers]

    def signal(self, node: Node) -> Signal:
        """Return what is known of a connector: for a component's, what the FMU says goes before the file."""
        declared = self.signals.get(node, Signal("", None, Unit()))
        if node.owner not in self.parts:
            return declared
        variable = self.variable(Port(*node))
        unit = declared.unit
        if variable.unit:
            unit = Unit(variable.unit, variable.base_unit or self.units.get(variable.unit))
        return Signal(variable.causality, variable.type, unit)

    # -- used while the description is read

    def declare(self, owner: str, entry: Element, kind: str, units: Units) -> None:
        """Note a connector or an entry of a dictionary."""
        node = Node(owner, entry.get("name"))
        if node in self.signals:
            raise CouplingError.report(
                f"{self.where}, connector {node}", expected="a new name", received="one that is taken"
            )
        types = [part for part in entry.iterchildren("*") if local_name(part) in TYPES]
        unit = unit_of(types[0], units) if types else Unit()
        self.signals[node] = Signal(kind, local_name(types[0]) if types else None, unit)

    def connect(self, path: str, connection: Element, dictionaries: dict[str, str]) -> None:
        """Note a connection of the system at `path`; SSP lets it be written from either end."""
        ends = [self._end(path, connection, end, dictionaries) for end in ("start", "end")]
        outgoing = [gives for _, gives in ends]
        if outgoing[0] is None:
            outgoing[0] = None if outgoing[1] is None else not outgoing[1]
        if outgoing[1] is None:
            outgoing[1] = None if outgoing[0] is None else not outgoing[0]
        if outgoing[0] is None or outgoing[0] == outgoing[1]:
            start, end = (self.signal(node).kind for node, _ in ends)
            raise self._error(connection, "a source and a target", f"{start} and {end}")
        (source, _), (target, _) = ends if outgoing[0] else reversed(ends)
        if target in self._drivers:
            raise CouplingError.report(
                f"{self.where}, input {target}",
                expected="exactly one driver",
                received=f"{self._drivers[target]} and {source}",
            )
        self._drivers[target] = source
        factor, offset = linear(connection)
        self._hops.setdefault(source, []).append(_Hop(target, factor, offset, not suppressed(connection)))

    def _end(self, path: str, connection: Element, end: str, dictionaries: dict[str, str]) -> tuple[Node, bool | None]:
        """Return the node at one end and whether it gives (True) or takes (False); None where the other end decides."""
        # An empty name means the system itself, as no name does; OMSimulator writes it.
        element, name = connection.get(f"{end}Element") or None, connection.get(f"{end}Connector")
        owner = path if element is None else dictionaries.get(element, join(path, element))
        node = Node(owner, name)
        if owner in self.parts:
            return node, self.variable(Port(*node)).causality in ("output", "calculatedParameter")
        if node not in self.signals:
            known = [known.name for known in self.signals if known.owner == owner]
            expected = f"{one_of('connector', known, name)} of {element or 'the system'}"
            raise self._error(connection, expected, repr(name))
        kind = self.signals[node].kind
        if element in dictionaries:
            return node, None
        if kind not in (*_INWARDS, *_OUTWARDS):
            raise self._error(connection, f"{node} to be an input, an output or a parameter", kind)
        return node, (kind in _INWARDS) == (element is None)

    def _error(self, connection: Element, expected: str, received: str) -> NdobError:
        return CouplingError.report(f"{self.where}, {label(connection)}", expected=expected, received=received)


def read_structure(
    where: str,
    root_system: Element,
    variable: Callable[[Port], Variable],
    units: Units,
    dictionary: Callable[[Element], tuple[Element, Units]],
) -> Structure:
    """Return the graph of a description.

    variable: what the FMU says of a component's variable, raising CouplingError for one that it has not. dictionary: a
    SignalDictionary of a system → its entries' parent, wherever that lies, and the units defined there. Raises
    CouplingError for names that are taken or unknown, for connections without a direction, and where a connector has
    two drivers.
    """
    structure = Structure(where, variable, dict(components(root_system)), units)
    _walk(structure, root_system, "", {}, dictionary)
    return structure


def _walk(
    structure: Structure,
    system: Element,
    path: str,
    visible: dict[str, str],
    dictionary: Callable[[Element], tuple[Element, Units]],
) -> None:
    for entry in children(system, "ssd:Connectors/ssd:Connector"):
        structure.declare(path, entry, entry.get("kind"), structure.units)
    for declared in children(system, "ssd:SignalDictionaries/ssd:SignalDictionary"):
        owner = f"{join(path, declared.get('name'))} (dictionary)"
        visible = {**visible, declared.get("name"): owner}
        entries, units = dictionary(declared)
        for entry in children(entries, "ssb:DictionaryEntry"):
            structure.declare(owner, entry, "inout", units)
    names: set[str] = set()
    references: dict[str, str] = {}
    for element in children(system, "ssd:Elements/*"):
        name, full = element.get("name"), join(path, element.get("name"))
        if name in names:
            raise CouplingError.report(
                f"{structure.where}, element {full}", expected="a new name", received="one that is taken"
            )
        names.add(name)
        kind = local_name(element)
        if kind == "System":
            _walk(structure, element, full, visible, dictionary)
        elif kind == "Component":
            for entry in children(element, "ssd:Connectors/ssd:Connector"):
                structure.declare(full, entry, entry.get("kind"), structure.units)
        else:
            wanted = element.get("dictionary")
            if wanted not in visible:
                raise CouplingError.report(
                    f"{structure.where}, {label(element)}",
                    expected=one_of("signal dictionary", visible, wanted),
                    received=repr(wanted),
                )
            references[name] = visible[wanted]
    for connection in children(system, "ssd:Connections/ssd:Connection"):
        structure.connect(path, connection, references)
