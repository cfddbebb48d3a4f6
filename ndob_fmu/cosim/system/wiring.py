"""Which value drives which input, as index arrays that are computed once before the run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.cosim.component import Component, Value, Variable, recordable
from ndob_fmu.cosim.system.inputs import InputTable
from ndob_fmu.cosim.system.ports import Connection, Port
from ndob_fmu.cosim.system.system import System
from ndob_fmu.errors import CouplingError, NdobError, UsageError, some_of
from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True, eq=False)
class Lane:
    """One component and where its values are on the bus. Arrays have one entry for each of ``inputs``.

    ratio: the component's step in communication steps.
    start_values: of its variables, by name.
    inputs: the inputs that are driven during the run, by name.
    sources: their positions on the bus.
    factors, offsets: the input is factor · (value on the bus) + offset.
    scaled: whether any factor is not 1 or any offset not 0.
    source_ratios: the step of the source's component in communication steps; 1 without extrapolation.
    leads: how far to extrapolate beyond the beginning of the step, in communication steps; 0 without extrapolation.
    outputs: the part of the bus that the component writes.
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
    """All signals on one bus: the outputs of each component in turn, then the columns of the input file.

    lanes: in the order of the steps.
    names, types: of the outputs, which are recorded.
    table: the input file's columns.
    links: the number of connections between components.
    undriven: the inputs that keep the start values of their components.
    """

    system: System
    lanes: tuple[Lane, ...]
    names: tuple[str, ...]
    types: tuple[str, ...]
    table: InputTable
    links: int
    undriven: tuple[str, ...]


def wire(
    system: System,
    table: InputTable,
    start_values: Mapping[Port, Value],
    order: Sequence[str] | None = None,
    *,
    strict: bool = False,
) -> Wiring:
    """Return the wiring of ``system`` with an input file's ``table`` and the start values given for this one run.

    A connection or a column of the table drives an input; its start value is what it has before the first exchange. An
    input without a driver keeps its start value: that of this run, else of the system, else of its component, which
    strict refuses. order: each component once, in the order of the steps; None means the system's. Raises CouplingError
    where an input has two drivers, or with strict no value, and for an unknown component in the order; UsageError if
    the order lacks a component or has one twice.
    """
    order = _order(system, order)
    connected = {connection.target: connection for connection in system.connections}
    for port in table.ports:
        if port in connected:
            received = f"a column of the input file and the connection from {connected[port].source}"
            raise CouplingError.report(f"input {port}", expected="exactly one driver", received=received)
    system = replace(system, start_values={**system.start_values, **start_values})
    undriven = undriven_inputs(system, table.ports)
    if strict and undriven:
        raise without_driver(undriven)

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
        undriven,
    )


def undriven_inputs(system: System, others: Iterable[Port] = ()) -> tuple[str, ...]:
    """Return the names of the inputs without a connection or a start value in the system, except ``others``."""
    driven = {*(connection.target for connection in system.connections), *system.start_values, *others}
    named = {link.port: name for name, links in system.inputs.items() for link in links}
    inputs = [
        Port(n, v.name) for n, part in system.components.items() for v in part.variables if v.causality == "input"
    ]
    return tuple(
        f"{port} (behind {named[port]})" if port in named else str(port) for port in inputs if port not in driven
    )


def keep_start_values(undriven: Sequence[str]) -> str:
    """Return the warning about inputs that nothing drives, which SSP 1.0.1 lets keep the start values of their FMUs."""
    if len(undriven) == 1:
        return f"nothing drives the input {some_of(undriven)}; it keeps its own start value"
    return f"nothing drives the inputs {some_of(undriven)}; they keep their own start values"


def without_driver(undriven: Sequence[str]) -> NdobError:
    """Return the error for inputs that nothing drives, where that is not allowed."""
    return CouplingError.report(
        f"input{'s' * (len(undriven) > 1)} {some_of(undriven)}",
        expected="a connection, a column of the input file or a start value",
        received="none of them",
        likely="with strict no start value is left to the component itself; give it explicitly",
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
    # A column of the input file acts like a connection without scaling.
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
    """Return the inputs on which a connected output depends directly.

    Such an output, read at the end of a step, is right only if the input is extrapolated to the end of the step.
    """
    used = {connection.source.variable for connection in system.connections if connection.source.component == name}
    return {u for v in component.variables if v.name in used for u in v.dependencies or ()}
