"""A coupled system as a value: components, connections and start values that do not contradict one another."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Integral
from pathlib import Path
from typing import Any, NamedTuple

from ndob_fmu.cosim.component import Component, Value, Variable
from ndob_fmu.cosim.experiment import Experiment
from ndob_fmu.cosim.fmi.fmu_component import FmuComponent
from ndob_fmu.cosim.values import convert
from ndob_fmu.errors import CouplingError, NdobError, UsageError, nearest, one_of
from ndob_fmu.support.units import Unit


class Port(NamedTuple):
    """One variable of one component of the system."""

    component: str
    variable: str

    def __str__(self) -> str:
        return f"{self.component}.{self.variable}"


class Connection(NamedTuple):
    """The output ``source`` drives the input ``target``, which receives factor · source + offset.

    convert_units: with the source converted to the target's unit before; a System does so and puts it into factor and
    offset.
    """

    source: Port
    target: Port
    factor: float = 1.0
    offset: float = 0.0
    convert_units: bool = True

    def __str__(self) -> str:
        return f"{self.source} → {self.target}"


class Link(NamedTuple):
    """A port behind a name at the system's boundary, where it has factor · value + offset: set by an input, shown by an
    output.
    """

    port: Port
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class System:
    """Components by name (their order is the order of Gauss–Seidel), what drives what, and start values.

    connections: (source, target), each (component, variable), or (source, target, factor, offset). start_values:
    (component, variable) → value; that of a connected input is its value before the first exchange. step_ratios:
    component → k for those that step over k communication steps at a time. inputs: names at the system's boundary → the
    inputs and parameters that a start value or a column of the input file of that name sets; outputs: further names
    that outputs are recorded under. warnings: what a run is to say of how the system was described.

    ``add``, ``connect`` and ``expose`` extend the system in place and return it, so that the calls can also be chained.
    A call that raises leaves the system as it was. ``copy.copy`` makes an independent variant, ``write`` a package:

        System().add("plant", "Plant.fmu").add("observer", "Observer.fmu").connect("plant.y", "observer.y")

    Raises CouplingError for an unknown component or variable, a wrong causality or type, units that no factor converts,
    a factor or offset of what is no Real, and an input with two drivers; UsageError for a start value that its variable
    cannot take, a factor or offset that is not finite, and a ratio that is not a whole number from 1 on.
    """

    components: Mapping[str, Component] = field(default_factory=dict)
    connections: tuple[Connection, ...] = ()
    start_values: Mapping[Port, Value] = field(default_factory=dict)
    step_ratios: Mapping[str, int] = field(default_factory=dict)
    inputs: Mapping[str, tuple[Link, ...]] = field(default_factory=dict)
    outputs: Mapping[str, Link] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    _variables: dict[str, dict[str, Variable]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "components", dict(self.components))
        tables = {name: {v.name: v for v in component.variables} for name, component in self.components.items()}
        object.__setattr__(self, "_variables", tables)
        object.__setattr__(self, "connections", tuple(self._connection(*parts) for parts in self.connections))
        self._check_drivers()
        starts = {Port(*port): value for port, value in self.start_values.items()}
        object.__setattr__(self, "start_values", {port: self._start(port, value) for port, value in starts.items()})
        ratios = {name: self._ratio(name, ratio) for name, ratio in self.step_ratios.items()}
        object.__setattr__(self, "step_ratios", ratios)
        object.__setattr__(self, "inputs", {name: self._input(name, links) for name, links in self.inputs.items()})
        object.__setattr__(self, "outputs", {name: self._output(name, link) for name, link in self.outputs.items()})

    def add(
        self,
        name: str,
        component: Component | str | Path,
        parameters: Mapping[str, Value] | None = None,
        *,
        step_ratio: int = 1,
    ) -> System:
        """Add a component, given as such or by the path of its FMU, and return the system.

        parameters: start values of its parameters and inputs. step_ratio: its step in
        communication steps. Raises CouplingError if there is a component of that name already.
        """
        if name in self.components:
            raise CouplingError.report(f"component {name}", expected="a new name", received="one that is taken")
        if isinstance(component, str | Path):
            component = FmuComponent(component, name)
        return self._extend(
            components={**self.components, name: component},
            start_values={**self.start_values, **{Port(name, key): value for key, value in (parameters or {}).items()}},
            step_ratios=self.step_ratios if step_ratio == 1 else {**self.step_ratios, name: step_ratio},
        )

    def connect(self, source: str, target: str, *, factor: float = 1.0, offset: float = 0.0) -> System:
        """Connect two ports named ``component.variable``, and return the system.

        The target receives factor · source + offset, with the source converted to the target's unit before.
        """
        connection = Connection(self.port(source), self.port(target), factor, offset)
        return self._extend(connections=(*self.connections, connection))

    def expose(self, name: str, *ports: str) -> System:
        """Name one output, or inputs and parameters that are set together, at the boundary, and return the system."""
        found = [self.port(port) for port in ports]
        if len(found) == 1 and self.variable(found[0]).causality == "output":
            return self._extend(outputs={**self.outputs, name: Link(found[0])})
        return self._extend(inputs={**self.inputs, name: tuple(Link(port) for port in found)})

    def write(
        self,
        path: str | Path,
        *,
        start_time: float = 0.0,
        stop_time: float | None = None,
        step_size: float | None = None,
        parameter_set: str = "nominal",
        description: str = "",
    ) -> Path:
        """Write the system with its FMUs as a package (.ssp) and return its path; the same system gives the same bytes.

        Times of the default experiment in seconds. parameter_set: the name under which all start values go. Names at
        the boundary become connectors, and those of parameters the entries of a parameter mapping; without any the
        package keeps to what libcosim, ecos, OMSimulator and fmpy read.

        An input that nothing drives goes with the start value of its FMU, and a warning is logged. Raises CouplingError
        for a component that is no FMU, and start values that contradict a name at the boundary; UsageError for step
        ratios without step_size and a file that cannot be written.
        """
        from ndob_fmu.cosim.ssp.write import write_ssp  # which knows systems

        experiment = Experiment(start_time, stop_time, step_size)
        return write_ssp(self, Path(path), experiment, parameter_set, description)

    def starts(self, name: str, value: Value) -> dict[Port, Value]:
        """Return what a value of ``component.variable``, or of an input at the boundary, is at each port behind it.

        Raises CouplingError for an unknown name, UsageError for a value that a variable cannot take.
        """
        if name not in self.inputs:
            return {self.port(name): value}
        found = {}
        for port, factor, offset in self.inputs[name]:
            own = convert(self.variable(port), value, name)
            found[port] = factor * float(own) + offset if (factor, offset) != (1.0, 0.0) else own
        return found

    def component(self, name: str) -> Component:
        """Return the component called ``name``; raise CouplingError, naming the nearest one, if there is none."""
        if name not in self.components:
            raise _unknown(f"component {name}", "component", name, self.components)
        return self.components[name]

    def variable(self, port: Port) -> Variable:
        """Return the variable behind ``port``; raise CouplingError, naming the nearest one, if there is none."""
        if port.component not in self._variables:
            raise _unknown(f"component of {port}", "component", port.component, self._variables)
        table = self._variables[port.component]
        if port.variable not in table:
            raise _unknown(f"variable of {port.component}", "variable", port.variable, table)
        return table[port.variable]

    def port(self, name: str) -> Port:
        """Return the port called ``component.variable``, or just ``variable`` in a system of one component.

        Raises CouplingError, naming the nearest one, if there is none.
        """
        ports = [Port(part, name[len(part) + 1 :]) for part in self.components if name.startswith(f"{part}.")]
        if not ports and len(self.components) == 1:
            ports = [Port(next(iter(self.components)), name)]
        found = next((port for port in ports if port.variable in self._variables[port.component]), None)
        if found is None and ports and not difflib.get_close_matches(name, self.inputs):
            self.variable(ports[0])
        if found is None:
            known = [str(Port(part, variable)) for part, table in self._variables.items() for variable in table]
            known += self.inputs
            whole = [full for full in known if full.endswith(f".{name}")] or difflib.get_close_matches(name, known, n=1)
            raise CouplingError.report(
                repr(name),
                expected=f"component.variable, with {one_of('component', self.components, name)}",
                received="no such component" if self.components else "a system without components",
                likely=f"did you mean {whole[0]!r}?" if whole else "",
            )
        return found

    def _extend(self, **changes: Any) -> System:
        extended = replace(self, **changes)  # raises for what contradicts itself, before anything is changed
        for name, value in vars(extended).items():
            object.__setattr__(self, name, value)
        return self

    def _connection(
        self, start: Port, end: Port, factor: float = 1.0, offset: float = 0.0, convert_units: bool = True
    ) -> Connection:
        connection = Connection(Port(*start), Port(*end), float(factor), float(offset), convert_units)
        source, target = self.variable(connection.source), self.variable(connection.target)
        _require(connection, f"an output as the source {connection.source}", source.causality, "output")
        _require(connection, f"an input as the target {connection.target}", target.causality, "input")
        _require(connection, f"the type {target.type} of {connection.target}", source.type, target.type)
        if source.type == "String":
            raise CouplingError.report(str(connection), expected="a numeric or Boolean signal", received="a String")
        _require_scaling(connection, source.type)
        if not convert_units:
            return connection
        given, wanted = Unit(source.unit, source.base_unit), Unit(target.unit, target.base_unit)
        scaling = given.to(wanted)
        if scaling is None:
            raise CouplingError.report(
                f"connection {connection}",
                expected=f"the unit {wanted} of {connection.target}, or one that converts to it",
                received=str(given),
            )
        if scaling == (1.0, 0.0):
            return connection
        return connection._replace(
            factor=connection.factor * scaling[0],
            offset=connection.factor * scaling[1] + connection.offset,
            convert_units=False,
        )

    def _check_drivers(self) -> None:
        drivers: dict[Port, str] = {}
        driven = [(c.target, str(c.source)) for c in self.connections]
        driven += [(Port(*link[0]), f"the input {name}") for name, links in self.inputs.items() for link in links]
        for target, driver in driven:
            if target in drivers:
                raise _driven_twice(target, f"{drivers[target]} and {driver}")
            drivers[target] = driver

    def _input(self, name: str, links: Iterable[Link]) -> tuple[Link, ...]:
        found = tuple(self._link(name, *link) for link in links)
        for link in found:
            variable = self.variable(link.port)
            if not variable.settable:
                received = f"{link.port} of causality {variable.causality}"
                raise CouplingError.report(f"input {name}", expected="variables that can be set", received=received)
        return found

    def _output(self, name: str, link: Link) -> Link:
        found = self._link(name, *link)
        variable = self.variable(found.port)
        if variable.causality != "output" or variable.type == "String":
            received = f"{found.port} of causality {variable.causality} and type {variable.type}"
            raise CouplingError.report(f"output {name}", expected="a numeric or Boolean output", received=received)
        return found

    def _link(self, name: str, port: Port, factor: float = 1.0, offset: float = 0.0) -> Link:
        link = Link(Port(*port), float(factor), float(offset))
        kind = self.variable(link.port).type
        if kind != "Real" and link[1:] != (1.0, 0.0):
            expected = f"no factor and no offset for {link.port} of type {kind}"
            raise CouplingError.report(name, expected=expected, received=f"{factor!r} and {offset!r}")
        return link

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
        return convert(variable, value, str(port))


def _unknown(where: str, kind: str, name: str, known: Iterable[str]) -> NdobError:
    names = sorted(known)
    expected = one_of(kind, names, name)
    return CouplingError.report(where, expected=expected, received=repr(name), likely=nearest(name, names))


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
