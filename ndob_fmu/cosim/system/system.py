"""A coupled system as a value: components, connections and start values that do not contradict one another."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ndob_fmu.cosim.component import Component, Value, Variable
from ndob_fmu.cosim.fmi.fmu_component import FmuComponent
from ndob_fmu.cosim.system import validation
from ndob_fmu.cosim.system.ports import AS_IT_IS, Connection, Link, Port
from ndob_fmu.cosim.values import convert
from ndob_fmu.errors import CouplingError, NdobError, nearest, one_of


@dataclass(frozen=True, eq=False)
class System:
    """Components, their connections and start values.

    components: by name, in the order of Gauss–Seidel.
    connections: (source, target), each (component, variable), or (source, target, factor, offset).
    start_values: (component, variable) → value; a connected input has it before the first exchange.
    step_ratios: component → its step in communication steps, where that is not 1.
    inputs: name at the boundary → the inputs and parameters that a start value or an input file sets by that name.
    outputs: name at the boundary → the output that is recorded by that name too.
    warnings: lines that a run logs about the system's description.

    ``add``, ``connect`` and ``expose`` extend the system in place and return it, so that the calls can also be chained.
    A call that raises leaves the system as it was. ``copy.copy`` makes an independent variant, and
    `ndob_fmu.write_ssp` a package:

        System().add("plant", "Plant.fmu").add("observer", "Observer.fmu").connect("plant.y", "observer.y")

    Raises CouplingError for an unknown component or variable, a wrong causality or type, units that no factor converts,
    a factor or offset of a variable that is not Real, and an input with two drivers; UsageError for a start value that
    its variable cannot take, a factor or offset that is not finite, and a ratio that is not a whole number from 1 on.
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
        variable = self.variable
        connections = tuple(validation.connection(variable, *parts) for parts in self.connections)
        object.__setattr__(self, "connections", connections)
        validation.check_drivers(connections, self.inputs)
        starts = {Port(*port): value for port, value in self.start_values.items()}
        starts = {port: validation.start_value(variable, port, value) for port, value in starts.items()}
        object.__setattr__(self, "start_values", starts)
        for name in self.step_ratios:
            self.component(name)
        ratios = {name: validation.step_ratio(name, ratio) for name, ratio in self.step_ratios.items()}
        object.__setattr__(self, "step_ratios", ratios)
        inputs = {name: validation.input_links(variable, name, links) for name, links in self.inputs.items()}
        object.__setattr__(self, "inputs", inputs)
        outputs = {name: validation.output_link(variable, name, link) for name, link in self.outputs.items()}
        object.__setattr__(self, "outputs", outputs)

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

    def starts(self, name: str, value: Value) -> dict[Port, Value]:
        """Return what a value of ``component.variable``, or of an input at the boundary, is at each port behind it.

        Raises CouplingError for an unknown name, UsageError for a value that a variable cannot take.
        """
        if name not in self.inputs:
            return {self.port(name): value}
        found = {}
        for port, factor, offset in self.inputs[name]:
            own = convert(self.variable(port), value, name)
            found[port] = factor * float(own) + offset if (factor, offset) != AS_IT_IS else own
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
        extended = replace(self, **changes)  # raises for contradictions before anything is changed
        for name, value in vars(extended).items():
            object.__setattr__(self, name, value)
        return self


def _unknown(where: str, kind: str, name: str, known: Iterable[str]) -> NdobError:
    names = sorted(known)
    expected = one_of(kind, names, name)
    return CouplingError.report(where, expected=expected, received=repr(name), likely=nearest(name, names))
