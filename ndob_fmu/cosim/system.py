"""A coupled system as a value: components, connections and start values that do not contradict one another."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from numbers import Integral
from typing import NamedTuple

from ndob_fmu.cosim.component import Component, Value, Variable
from ndob_fmu.cosim.values import convert
from ndob_fmu.errors import CouplingError, NdobError, UsageError


class Port(NamedTuple):
    """One variable of one component of the system."""

    component: str
    variable: str

    def __str__(self) -> str:
        return f"{self.component}.{self.variable}"


class Connection(NamedTuple):
    """The output ``source`` drives the input ``target``, which receives factor · source + offset."""

    source: Port
    target: Port
    factor: float = 1.0
    offset: float = 0.0

    def __str__(self) -> str:
        return f"{self.source} → {self.target}"


@dataclass(frozen=True, eq=False)
class System:
    """Components by name (their order is the order of Gauss–Seidel), what drives what, and start values.

    connections: (source, target), each (component, variable), or (source, target, factor, offset). start_values:
    (component, variable) → value. step_ratios: component → k for those that step over k communication steps at a time.
    Raises CouplingError for an unknown component or variable, a wrong causality, type or unit, a factor or offset of
    what is no Real, and an input with two drivers; UsageError for a start value that its variable cannot take, a factor
    or offset that is not finite, and a ratio that is not a whole number from 1 on.
    """

    components: Mapping[str, Component]
    connections: tuple[Connection, ...] = ()
    start_values: Mapping[Port, Value] = field(default_factory=dict)
    step_ratios: Mapping[str, int] = field(default_factory=dict)
    _variables: dict[str, dict[str, Variable]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "components", dict(self.components))
        tables = {name: {v.name: v for v in component.variables} for name, component in self.components.items()}
        object.__setattr__(self, "_variables", tables)
        connections = tuple(
            Connection(Port(*source), Port(*target), *map(float, scaling))
            for source, target, *scaling in self.connections
        )
        object.__setattr__(self, "connections", connections)
        self._check_connections()
        starts = {Port(*port): value for port, value in self.start_values.items()}
        object.__setattr__(self, "start_values", {port: self._start(port, value) for port, value in starts.items()})
        ratios = {name: self._ratio(name, ratio) for name, ratio in self.step_ratios.items()}
        object.__setattr__(self, "step_ratios", ratios)

    def component(self, name: str) -> Component:
        """Return the component called ``name``; raise CouplingError, naming the nearest one, if there is none."""
        if name not in self.components:
            raise _unknown("component", name, self.components)
        return self.components[name]

    def variable(self, port: Port) -> Variable:
        """Return the variable behind ``port``; raise CouplingError, naming the nearest one, if there is none."""
        if port.component not in self._variables:
            raise _unknown(f"component of {port}", port.component, self._variables)
        table = self._variables[port.component]
        if port.variable not in table:
            raise _unknown(f"variable of {port.component}", port.variable, table)
        return table[port.variable]

    def port(self, name: str) -> Port:
        """Return the port called ``component.variable``, or just ``variable`` in a system of one component.

        Raises CouplingError, naming the nearest one, if there is none.
        """
        ports = [Port(part, name[len(part) + 1 :]) for part in self.components if name.startswith(f"{part}.")]
        if not ports and len(self.components) == 1:
            ports = [Port(next(iter(self.components)), name)]
        found = next((port for port in ports if port.variable in self._variables[port.component]), None)
        if found is None and ports:
            self.variable(ports[0])
        if found is None:
            known = [str(Port(part, variable)) for part, table in self._variables.items() for variable in table]
            whole = [full for full in known if full.endswith(f".{name}")] or difflib.get_close_matches(name, known, n=1)
            raise CouplingError.report(
                repr(name),
                expected=f"component.variable of one of the components {', '.join(self.components)}",
                received="no such component",
                likely=f"did you mean {whole[0]!r}?" if whole else "",
            )
        return found

    def _check_connections(self) -> None:
        drivers: dict[Port, Port] = {}
        for connection in self.connections:
            source, target = self.variable(connection.source), self.variable(connection.target)
            _require(connection, f"an output as the source {connection.source}", source.causality, "output")
            _require(connection, f"an input as the target {connection.target}", target.causality, "input")
            _require(connection, f"the type {target.type} of {connection.target}", source.type, target.type)
            if source.unit and target.unit:
                _require(connection, f"the unit {target.unit} of {connection.target}", source.unit, target.unit)
            if source.type == "String":
                raise CouplingError.report(str(connection), expected="a numeric or Boolean signal", received="a String")
            _require_scaling(connection, source.type)
            if connection.target in drivers:
                raise _driven_twice(connection.target, f"{drivers[connection.target]} and {connection.source}")
            drivers[connection.target] = connection.source

    def _ratio(self, name: str, ratio: int) -> int:
        self.component(name)
        if not isinstance(ratio, Integral) or isinstance(ratio, bool) or ratio < 1:
            raise UsageError.report(
                f"step ratio of {name}",
                expected="a whole number of communication steps, 1 or more",
                received=repr(ratio),
                likely="the communication step must divide the step of every component",
            )
        return int(ratio)

    def _start(self, port: Port, value: Value) -> Value:
        variable = self.variable(port)
        if not variable.settable:
            raise CouplingError.report(
                str(port), expected="a variable that takes a start value", received=f"causality {variable.causality}"
            )
        source = next((c.source for c in self.connections if c.target == port), None)
        if source is not None:
            raise _driven_twice(port, f"the connection from {source} and the start value {value}")
        return convert(variable, value, str(port))


def _unknown(where: str, name: str, known: Iterable[str]) -> NdobError:
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1)
    listed = ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")
    likely = f"did you mean {near[0]!r}?" if near else ""
    return CouplingError.report(where, expected=f"one of {listed or 'none'}", received=repr(name), likely=likely)


def _require(connection: Connection, expected: str, received: str, wanted: str) -> None:
    if received != wanted:
        raise CouplingError.report(f"connection {connection}", expected=expected, received=received)


def _require_scaling(connection: Connection, kind: str) -> None:
    scaling = (connection.factor, connection.offset)
    received = f"{connection.factor!r} and {connection.offset!r}"
    if not all(map(math.isfinite, scaling)):
        raise UsageError.report(f"connection {connection}", expected="a finite factor and offset", received=received)
    if kind != "Real" and scaling != (1.0, 0.0):
        raise CouplingError.report(
            f"connection {connection}",
            expected=f"no factor and no offset for a signal of type {kind}",
            received=received,
        )


def _driven_twice(port: Port, drivers: str) -> NdobError:
    return CouplingError.report(f"input {port}", expected="exactly one driver", received=drivers)
