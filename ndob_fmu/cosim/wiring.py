"""Where every input takes its value from, as index arrays computed once before the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.cosim.component import Array, Component, Value, Variable, recordable
from ndob_fmu.cosim.inputs import InputTable
from ndob_fmu.cosim.system import Connection, Port, System
from ndob_fmu.errors import CouplingError, UsageError, some_of


@dataclass(frozen=True, eq=False)
class Lane:
    """One component's place on the bus.

    ratio: its step in communication steps. inputs: the names that are driven during the run, and over (len(inputs),)
    sources: their positions on the bus; factors and offsets: what is made of the value there (scaled: of any);
    source_ratios: the step of the component that writes it; leads: how far the instant whose value it is to hold lies
    behind the beginning of the step, both in communication steps; 1 and 0 for what is not extrapolated.
    outputs: the stretch of the bus that the component writes.
    """

    name: str
    component: Component
    ratio: int
    start_values: Mapping[str, Value]
    inputs: tuple[str, ...]
    sources: NDArray[np.intp]
    factors: Array
    offsets: Array
    scaled: bool
    source_ratios: Array
    leads: Array
    outputs: slice


@dataclass(frozen=True, eq=False)
class Wiring:
    """All signals side by side on one bus: the outputs of each component in turn, then the columns of the input file.

    lanes: in the order of the steps. names, types: of the outputs, the recorded part. links: the number of connections
    between components.
    """

    system: System
    lanes: tuple[Lane, ...]
    names: tuple[str, ...]
    types: tuple[str, ...]
    table: InputTable
    links: int


def wire(
    system: System, table: InputTable, start_values: Mapping[Port, Value], order: Sequence[str] | None = None
) -> Wiring:
    """Return the wiring of ``system`` with an input file's ``table`` and the start values given for this one run.

    Every input must be driven exactly once: by a connection, a column of the table, or a start value. The start values
    of this run replace those of the system, and so do the table's columns; a column and a start value of this run for
    the same input contradict. order: each component once, in the order of the steps; None means the system's. Raises
    CouplingError where an input has no driver or two, and for an unknown component in the order; UsageError if the
    order lacks a component or has one twice.
    """
    order = _order(system, order)
    connected = {connection.target: connection for connection in system.connections}
    for port in table.ports:
        if port in connected or port in start_values:
            other = (
                f"the connection from {connected[port].source}" if port in connected else "a start value of this run"
            )
            raise CouplingError.report(
                f"input {port}", expected="exactly one driver", received=f"a column of the input file and {other}"
            )
    kept = {port: value for port, value in system.start_values.items() if port not in table.ports}
    system = replace(system, start_values={**kept, **start_values})
    require_drivers(system, {*connected, *table.ports, *system.start_values})

    outputs = [
        (Port(name, variable.name), variable.type)
        for name, component in system.components.items()
        for variable in recordable(component.variables)
    ]
    position = {port: index for index, (port, _) in enumerate(outputs)}
    sources = {target: position[connection.source] for target, connection in connected.items()}
    sources |= {port: len(outputs) + column for column, port in enumerate(table.ports)}
    return Wiring(
        system,
        tuple(_lane(system, name, sources, position, connected) for name in order),
        tuple(str(port) for port, _ in outputs),
        tuple(kind for _, kind in outputs),
        table,
        len(system.connections),
    )


def require_drivers(system: System, driven: set[Port]) -> None:
    """Raise CouplingError, naming them, for the inputs that are not among those driven."""
    inputs = [
        Port(n, v.name) for n, part in system.components.items() for v in part.variables if v.causality == "input"
    ]
    named = {link.port: name for name, links in system.inputs.items() for link in links}
    missing = [
        f"{port} (behind {named[port]})" if port in named else str(port) for port in inputs if port not in driven
    ]
    if missing:
        raise CouplingError.report(
            f"input{'s' * (len(missing) > 1)} {some_of(missing)}",
            expected="a connection, a column of the input file or a start value",
            received="none of them",
            likely="a start value was left to the component's own default; give it explicitly",
        )


def _order(system: System, order: Sequence[str] | None) -> Sequence[str]:
    if order is None:
        return tuple(system.components)
    for name in order:
        system.component(name)
    if sorted(order) != sorted(system.components):
        expected = f"each of the components {some_of(system.components)} once"
        raise UsageError.report("order", expected=expected, received=some_of(order))
    return order


def _lane(
    system: System,
    name: str,
    sources: Mapping[Port, int],
    position: Mapping[Port, int],
    connected: Mapping[Port, Connection],
) -> Lane:
    component = system.components[name]
    ports = [Port(name, v.name) for v in component.variables if Port(name, v.name) in sources]
    own = [index for port, index in position.items() if port.component == name]
    # A column of the input file is what a connection is that changes nothing.
    links = [connected.get(port, Connection(port, port)) for port in ports]
    scaling = np.array([(link.factor, link.offset) for link in links]).reshape(-1, 2)
    extrapolated = [
        port in connected and _continuous(system.variable(link.source)) and _continuous(system.variable(port))
        for port, link in zip(ports, links, strict=True)
    ]
    ratio = system.step_ratios.get(name, 1)
    shown = _shown_at_once(system, component, name)
    return Lane(
        name,
        component,
        ratio,
        {port.variable: value for port, value in system.start_values.items() if port.component == name},
        tuple(port.variable for port in ports),
        np.array([sources[port] for port in ports], dtype=np.intp),
        scaling[:, 0].copy(),
        scaling[:, 1].copy(),
        bool((scaling != (1.0, 0.0)).any()),
        np.where(extrapolated, [system.step_ratios.get(link.source.component, 1) for link in links], 1.0),
        np.where(extrapolated, [ratio if port.variable in shown else ratio / 2 for port in ports], 0.0),
        slice(own[0], own[-1] + 1) if own else slice(0, 0),
    )


def _continuous(variable: Variable) -> bool:
    return variable.type == "Real" and variable.variability == "continuous"


def _shown_at_once(system: System, component: Component, name: str) -> set[str]:
    """Return the inputs that an output which drives something declares to show at once.

    Such an output, got at the end of a step, is right only if the input was right there, and not in the middle.
    """
    used = {connection.source.variable for connection in system.connections if connection.source.component == name}
    return {u for v in component.variables if v.name in used for u in v.dependencies or ()}
