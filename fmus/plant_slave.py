"""`<Name>Plant`: the plant with its built-in disturbance generators, one step of the core per doStep."""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite
from typing import Any

from pythonfmu.enums import Fmi2Status

from fmus.slave_base import Slave
from ndob_fmu.runtime.disturbance import Generator
from ndob_fmu.runtime.interface import Variable, for_each_disturbance, plant_variables
from ndob_fmu.runtime.plant import Plant, PlantState


class PlantSlave(Slave):
    """Integrates the plant; inputs are held over the step, the generators run on inside it."""

    def declare(self) -> tuple[Variable, ...]:
        """Return the plant's variables."""
        return plant_variables(self.equations)

    def start(self, start_time: float) -> None:
        """Make the plant and its start state from the parameters."""
        eq = self.equations
        parameters = self.values(eq.parameters)
        generators = [
            Generator(*self.values(f"{prefix}.{field}" for field in ("kind", "amplitude", "frequency", "start_time")))
            for prefix in for_each_disturbance("disturbance", eq.disturbances).values()
        ]
        self.plant = Plant(equations=eq, parameters=parameters, generators=generators)
        self.state: PlantState = self.plant.init(self.values(f"{name}_start" for name in eq.states), start_time)
        self.C = eq.linear_part(parameters).C
        self.hidden_states = [i for i, name in enumerate(eq.states) if name not in eq.outputs]
        self.held = [0.0] * (len(eq.inputs) + len(eq.disturbances))

    def show(self) -> Iterable[Any]:
        """Return outputs, the other states and total disturbances at the present time."""
        return self._outputs(self._inputs()[1])

    def advance(self, t: float, step_size: float) -> Iterable[Any]:
        """Integrate to the end of the step."""
        u, d = self._inputs()
        self.state = self.plant.step(self.state, u, d, t + step_size)
        return self._outputs(d)

    def _inputs(self) -> tuple[list[float], list[float]]:
        """Return u and d as set; a value that is not finite is replaced by the last finite one, so that x survives."""
        eq = self.equations
        given = self.values([*eq.inputs, *eq.disturbances])
        if not all(map(isfinite, given)):
            self.log(f"inputs that are not finite are held at t = {self.state.t:g} s", Fmi2Status.warning)
            given = [new if isfinite(new) else old for new, old in zip(given, self.held, strict=True)]
        self.held = given
        return given[: len(eq.inputs)], given[len(eq.inputs) :]

    def _outputs(self, d: list[float]) -> list[float]:
        x = self.state.x
        return [*(self.C @ x), *(x[i] for i in self.hidden_states), *self.plant.disturbance(self.state.t, d)]
