"""Reading the connectors and connections of a description, with those of nested systems, as one graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from ndob_fmu.cosim.component import Variable
from ndob_fmu.cosim.ssp.scaling import Units, linear, suppressed, unit_of
from ndob_fmu.cosim.ssp.schema import Element, children, local_name
from ndob_fmu.cosim.ssp.structure import INWARDS, OUTWARDS, Hop, Node, Signal, Structure, components, join
from ndob_fmu.cosim.ssp.supported import TYPES, label
from ndob_fmu.cosim.system.ports import Port
from ndob_fmu.errors import CouplingError, NdobError, one_of
from ndob_fmu.support.units import Unit

# A SignalDictionary of a system → the parent of its entries, wherever that lies, and the units defined there.
Dictionary: TypeAlias = Callable[[Element], tuple[Element, Units]]


def read_structure(
    where: str,
    root_system: Element,
    variable: Callable[[Port], Variable],
    units: Units,
    dictionary: Dictionary,
) -> Structure:
    """Return the graph of a description.

    variable: what the FMU says of a component's variable, raising CouplingError for one that it has not. dictionary: a
    SignalDictionary of a system → its entries' parent, wherever that lies, and the units defined there. Raises
    CouplingError for names that are taken or unknown, for connections without a direction, and where a connector has
    two drivers.
    """
    structure = Structure(where, variable, dict(components(root_system)), units)
    _Reader(structure, dictionary).walk(root_system, "", {})
    return structure


class _Reader:
    """Fills a structure's tables in the order of the file."""

    def __init__(self, structure: Structure, dictionary: Dictionary) -> None:
        self._graph = structure
        self._dictionary = dictionary

    def walk(self, system: Element, path: str, visible: dict[str, str]) -> None:
        """Note the connectors and connections of a system and of those inside it.

        visible: the names under which the dictionaries of this system and those around it can be referred to.
        """
        for entry in children(system, "ssd:Connectors/ssd:Connector"):
            self._declare(path, entry, entry.get("kind"), self._graph.units)
        for declared in children(system, "ssd:SignalDictionaries/ssd:SignalDictionary"):
            owner = f"{join(path, declared.get('name'))} (dictionary)"
            visible = {**visible, declared.get("name"): owner}
            entries, units = self._dictionary(declared)
            for entry in children(entries, "ssb:DictionaryEntry"):
                self._declare(owner, entry, "inout", units)
        names: set[str] = set()
        references: dict[str, str] = {}
        for element in children(system, "ssd:Elements/*"):
            name, full = element.get("name"), join(path, element.get("name"))
            if name in names:
                raise CouplingError.report(
                    f"{self._graph.where}, element {full}", expected="a new name", received="one that is taken"
                )
            names.add(name)
            kind = local_name(element)
            if kind == "System":
                self.walk(element, full, visible)
            elif kind == "Component":
                for entry in children(element, "ssd:Connectors/ssd:Connector"):
                    self._declare(full, entry, entry.get("kind"), self._graph.units)
            else:
                wanted = element.get("dictionary")
                if wanted not in visible:
                    raise CouplingError.report(
                        f"{self._graph.where}, {label(element)}",
                        expected=one_of("signal dictionary", visible, wanted),
                        received=repr(wanted),
                    )
                references[name] = visible[wanted]
        for connection in children(system, "ssd:Connections/ssd:Connection"):
            self._connect(path, connection, references)

    def _declare(self, owner: str, entry: Element, kind: str, units: Units) -> None:
        """Note a connector or an entry of a dictionary."""
        node = Node(owner, entry.get("name"))
        if node in self._graph.signals:
            raise CouplingError.report(
                f"{self._graph.where}, connector {node}", expected="a new name", received="one that is taken"
            )
        types = [part for part in entry.iterchildren("*") if local_name(part) in TYPES]
        unit = unit_of(types[0], units) if types else Unit()
        self._graph.signals[node] = Signal(kind, local_name(types[0]) if types else None, unit)

    def _connect(self, path: str, connection: Element, dictionaries: dict[str, str]) -> None:
        """Note a connection of the system at `path`; SSP lets it be written from either end."""
        ends = [self._end(path, connection, end, dictionaries) for end in ("start", "end")]
        outgoing = [gives for _, gives in ends]
        if outgoing[0] is None:
            outgoing[0] = None if outgoing[1] is None else not outgoing[1]
        if outgoing[1] is None:
            outgoing[1] = None if outgoing[0] is None else not outgoing[0]
        if outgoing[0] is None or outgoing[0] == outgoing[1]:
            start, end = (self._graph.signal(node).kind for node, _ in ends)
            raise self._error(connection, "a source and a target", f"{start} and {end}")
        (source, _), (target, _) = ends if outgoing[0] else reversed(ends)
        if target in self._graph.drivers:
            raise CouplingError.report(
                f"{self._graph.where}, input {target}",
                expected="exactly one driver",
                received=f"{self._graph.drivers[target]} and {source}",
            )
        self._graph.drivers[target] = source
        factor, offset = linear(connection)
        self._graph.hops.setdefault(source, []).append(Hop(target, factor, offset, not suppressed(connection)))

    def _end(self, path: str, connection: Element, end: str, dictionaries: dict[str, str]) -> tuple[Node, bool | None]:
        """Return the node at one end; True for a source, False for a target, None where the other end decides."""
        # An empty name means the system itself, as no name does; OMSimulator writes it.
        element, name = connection.get(f"{end}Element") or None, connection.get(f"{end}Connector")
        owner = path if element is None else dictionaries.get(element, join(path, element))
        node = Node(owner, name)
        if owner in self._graph.parts:
            return node, self._graph.variable(Port(*node)).causality in ("output", "calculatedParameter")
        if node not in self._graph.signals:
            known = [known.name for known in self._graph.signals if known.owner == owner]
            expected = f"{one_of('connector', known, name)} of {element or 'the system'}"
            raise self._error(connection, expected, repr(name))
        kind = self._graph.signals[node].kind
        if element in dictionaries:
            return node, None
        if kind not in (*INWARDS, *OUTWARDS):
            raise self._error(connection, f"{node} to be an input, an output or a parameter", kind)
        return node, (kind in INWARDS) == (element is None)

    def _error(self, connection: Element, expected: str, received: str) -> NdobError:
        return CouplingError.report(f"{self._graph.where}, {label(connection)}", expected=expected, received=received)
