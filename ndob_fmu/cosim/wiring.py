"""Where every input takes its value from, as index arrays computed once before the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.cosim.component import Component, Value, recordable
from ndob_fmu.cosim.inputs import InputTable
from ndob_fmu.cosim.system import Port, System
from ndob_fmu.errors import CouplingError


@dataclass(frozen=True, eq=False)
class Lane:
    """One component's place on the bus.

    inputs: the names that are driven during the run. sources: (len(inputs),), their positions on the bus.
    outputs: the stretch of the bus that the component writes.
    """

    name: str
    component: Component
    start_values: Mapping[str, Value]
    inputs: tuple[str, ...]
    sources: NDArray[np.intp]
    outputs: slice


@dataclass(frozen=True, eq=False)
class Wiring:
    """All signals side by side on one bus: the outputs of each component in turn, then the columns of the input file.

    names, types: of the outputs, the recorded part. links: the number of connections between components.
    """

    lanes: tuple[Lane, ...]
    names: tuple[str, ...]
    types: tuple[str, ...]
    table: InputTable
    links: int


def wire(system: System, table: InputTable, start_values: Mapping[Port, Value]) -> Wiring:
    """Return the wiring of ``system`` with an input file's ``table`` and the start values given for this one run.

    Every input must be driven exactly once: by a connection, a column of the table, or a start value. The start values
    of this run replace those of the system, and so do the table's columns; a column and a start value of this run for
    the same input contradict. Raises CouplingError where an input has no driver or two.
    """
    connected = {connection.target: connection.source for connection in system.connections}
    for port in table.ports:
        if port in connected or port in start_values:
            other = f"the connection from {connected[port]}" if port in connected else "a start value of this run"
            raise CouplingError.report(
                f"input {port}", expected="exactly one driver", received=f"a column of the input file and {other}"
            )
    kept = {port: value for port, value in system.start_values.items() if port not in table.ports}
    system = replace(system, start_values={**kept, **start_values})
    _require_drivers(system, {*connected, *table.ports, *system.start_values})

    outputs = [
        (Port(name, variable.name), variable.type)
        for name, component in system.components.items()
        for variable in recordable(component.variables)
    ]
    position = {port: index for index, (port, _) in enumerate(outputs)}
    sources = {target: position[source] for target, source in connected.items()}
    sources |= {port: len(outputs) + column for column, port in enumerate(table.ports)}
    return Wiring(
        tuple(_lane(system, name, sources, position) for name in system.components),
        tuple(str(port) for port, _ in outputs),
        tuple(kind for _, kind in outputs),
        table,
        len(system.connections),
    )


def _require_drivers(system: System, driven: set[Port]) -> None:
    inputs = [
        Port(n, v.name) for n, part in system.components.items() for v in part.variables if v.causality == "input"
    ]
    missing = [str(port) for port in inputs if port not in driven]
    if missing:
        raise CouplingError.report(
            f"input{'s' * (len(missing) > 1)} {', '.join(missing)}",
            expected="a connection, a column of the input file or a start value",
            received="none of them",
            likely="a start value was left to the component's own default; give it explicitly",
        )


def _lane(system: System, name: str, sources: Mapping[Port, int], position: Mapping[Port, int]) -> Lane:
    component = system.components[name]
    inputs = tuple(v.name for v in component.variables if Port(name, v.name) in sources)
    own = [index for port, index in position.items() if port.component == name]
    return Lane(
        name,
        component,
        {port.variable: value for port, value in system.start_values.items() if port.component == name},
        inputs,
        np.array([sources[Port(name, variable)] for variable in inputs], dtype=np.intp),
        slice(own[0], own[-1] + 1) if own else slice(0, 0),
    )
