"""Algebraic loops: signals that depend on themselves without a delay."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from ndob_fmu.cosim.system.ports import Port
from ndob_fmu.cosim.system.system import System
from ndob_fmu.errors import some_of


@dataclass(frozen=True)
class AlgebraicLoop:
    """An algebraic loop.

    ports: outputs and inputs in the order of the signal, beginning with an output; the last drives the first.
    declared: whether every component of the loop declares the dependency; else one of them declares nothing, and the
        loop may not exist.
    """

    ports: tuple[Port, ...]
    declared: bool

    def __str__(self) -> str:
        return some_of(map(str, (*self.ports, self.ports[0])), between=" → ")


def algebraic_loops(system: System, *, initial: bool) -> tuple[AlgebraicLoop, ...]:
    """Return the loops in the system's connections and its components' dependencies.

    initial: those of the initialization, else those of the communication points. A shortest loop is named for every
    output that lies on one, each output in one loop only; a declared loop goes before one that may not exist.
    """
    found: list[AlgebraicLoop] = []
    for declared in (True, False):
        graph = _graph(system, initial, declared)
        for port in graph:
            named = any(port in loop.ports for loop in found)
            ports = () if named or system.variable(port).causality != "output" else _shortest(graph, port)
            if ports:
                found.append(AlgebraicLoop(ports, declared))
    return tuple(found)


def _graph(system: System, initial: bool, declared: bool) -> Mapping[Port, list[Port]]:
    """Return where a signal goes from each port, through connections and through components."""
    graph: dict[Port, list[Port]] = {}
    for connection in system.connections:
        graph.setdefault(connection.source, []).append(connection.target)
    driven = {connection.target for connection in system.connections}
    for output in list(graph):
        variable = system.variable(output)
        dependencies = variable.initial_dependencies if initial else variable.dependencies
        for port in driven:
            if port.component != output.component:
                continue
            if port.variable in dependencies if dependencies is not None else not declared:
                graph.setdefault(port, []).append(output)
    return graph


def _shortest(graph: Mapping[Port, list[Port]], start: Port) -> tuple[Port, ...]:
    """Return the shortest way from ``start`` back to it, without its end; empty if there is none."""
    before: dict[Port, Port] = {}
    waiting = deque([start])
    while waiting:
        port = waiting.popleft()
        for after in graph.get(port, []):
            if after == start:
                way = [port]
                while way[-1] != start:
                    way.append(before[way[-1]])
                return tuple(reversed(way))
            if after not in before:
                before[after] = port
                waiting.append(after)
    return ()
