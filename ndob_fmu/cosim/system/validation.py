"""What a system checks of its connections, start values, step ratios and names at its boundary.

``variable`` is `System.variable`: port → its variable; it raises CouplingError for a port that does not exist.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Integral
from typing import TypeAlias

from ndob_fmu.cosim.component import Value, Variable
from ndob_fmu.cosim.system.ports import AS_IT_IS, Connection, Link, Port
from ndob_fmu.cosim.values import convert
from ndob_fmu.errors import CouplingError, UsageError
from ndob_fmu.support.units import Unit

Lookup: TypeAlias = Callable[[Port], Variable]


def connection(
    variable: Lookup, start: Port, end: Port, factor: float = 1.0, offset: float = 0.0, convert_units: bool = True
) -> Connection:
    """Return a connection with the conversion of units in its factor and offset.

    Raises CouplingError unless it goes from an output to an input of the same type and of units that convert,
    UsageError for a factor or offset that is not finite.
    """
    made = Connection(Port(*start), Port(*end), float(factor), float(offset), convert_units)
    source, target = variable(made.source), variable(made.target)
    _require(made, f"an output as the source {made.source}", source.causality, "output")
    _require(made, f"an input as the target {made.target}", target.causality, "input")
    _require(made, f"the type {target.type} of {made.target}", source.type, target.type)
    if source.type == "String":
        raise CouplingError.report(str(made), expected="a numeric or Boolean signal", received="a String")
    _require_scaling(made, source.type)
    if not convert_units:
        return made
    given, wanted = Unit(source.unit, source.base_unit), Unit(target.unit, target.base_unit)
    scaling = given.to(wanted)
    if scaling is None:
        raise CouplingError.report(
            f"connection {made}",
            expected=f"the unit {wanted} of {made.target}, or one that converts to it",
            received=str(given),
        )
    if scaling == AS_IT_IS:
        return made
    return made._replace(
        factor=made.factor * scaling[0], offset=made.factor * scaling[1] + made.offset, convert_units=False
    )


def check_drivers(connections: Sequence[Connection], inputs: Mapping[str, Iterable[Link]]) -> None:
    """Raise CouplingError for an input that two connections or names at the boundary drive."""
    drivers: dict[Port, str] = {}
    driven = [(c.target, str(c.source)) for c in connections]
    driven += [(Port(*link[0]), f"the input {name}") for name, links in inputs.items() for link in links]
    for target, driver in driven:
        if target in drivers:
            received = f"{drivers[target]} and {driver}"
            raise CouplingError.report(f"input {target}", expected="exactly one driver", received=received)
        drivers[target] = driver


def start_value(variable: Lookup, port: Port, value: Value) -> Value:
    """Return a start value in its variable's type; raise CouplingError if the variable takes none."""
    found = variable(port)
    if not found.settable:
        raise CouplingError.report(
            str(port), expected="a variable that takes a start value", received=f"causality {found.causality}"
        )
    return convert(found, value, str(port))


def step_ratio(name: str, ratio: int) -> int:
    """Return a component's step in communication steps; raise UsageError unless it is a whole number ≥ 1."""
    if not isinstance(ratio, Integral) or isinstance(ratio, bool) or ratio < 1:
        raise UsageError.report(
            f"step ratio of {name}",
            expected="a whole number of communication steps, 1 or more",
            received=repr(ratio),
            likely="the communication step must divide the step of every component",
        )
    return int(ratio)


def input_links(variable: Lookup, name: str, links: Iterable[Link]) -> tuple[Link, ...]:
    """Return what an input at the boundary sets; raise CouplingError for a variable that cannot be set."""
    found = tuple(_link(variable, name, *link) for link in links)
    for link in found:
        target = variable(link.port)
        if not target.settable:
            received = f"{link.port} of causality {target.causality}"
            raise CouplingError.report(f"input {name}", expected="variables that can be set", received=received)
    return found


def output_link(variable: Lookup, name: str, link: Link) -> Link:
    """Return what an output at the boundary shows; raise CouplingError unless that is a numeric or Boolean output."""
    found = _link(variable, name, *link)
    source = variable(found.port)
    if source.causality != "output" or source.type == "String":
        received = f"{found.port} of causality {source.causality} and type {source.type}"
        raise CouplingError.report(f"output {name}", expected="a numeric or Boolean output", received=received)
    return found


def _link(variable: Lookup, name: str, port: Port, factor: float = 1.0, offset: float = 0.0) -> Link:
    link = Link(Port(*port), float(factor), float(offset))
    kind = variable(link.port).type
    if kind != "Real" and link[1:] != AS_IT_IS:
        expected = f"no factor and no offset for {link.port} of type {kind}"
        raise CouplingError.report(name, expected=expected, received=f"{factor!r} and {offset!r}")
    return link


def _require(made: Connection, expected: str, received: str, wanted: str) -> None:
    if received != wanted:
        raise CouplingError.report(f"connection {made}", expected=expected, received=received)


def _require_scaling(made: Connection, kind: str) -> None:
    scaling = (made.factor, made.offset)
    received = f"{made.factor!r} and {made.offset!r}"
    if not all(map(math.isfinite, scaling)):
        raise UsageError.report(f"connection {made}", expected="a finite factor and offset", received=received)
    if kind != "Real" and scaling != AS_IT_IS:
        raise CouplingError.report(
            f"connection {made}",
            expected=f"no factor and no offset for a signal of type {kind}",
            received=received,
        )
