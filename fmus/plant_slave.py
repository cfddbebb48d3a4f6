"""`<Name>Plant`: the plant with its built-in disturbance generators, one step of the core per doStep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from pythonfmu.enums import Fmi2Status

from fmus.slave_base import Slave
from ndob_fmu.interface.model_variables import for_each_disturbance, plant_variables
from ndob_fmu.runtime.blocks.disturbance import Generator
from ndob_fmu.runtime.blocks.plant import Plant, PlantState
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.times import same_time


@dataclass(frozen=True)
class PlantMemory:
    """The plant's state, and the last finite inputs and disturbances (m + q2,)."""

    plant: PlantState
    held: tuple[float, ...]


class PlantSlave(Slave):
    """Integrates the plant; inputs are held over the step, the generators run on inside it."""

    state_types = (PlantMemory, PlantState)
    state: PlantMemory

    def __init__(self, equations: Equations, **kwargs: Any) -> None:
        self.equations = equations
        super().__init__(plant_variables(equations), **kwargs)
        self._inputs_at = self.variables.stretch([*equations.inputs, *equations.disturbances])

    def start(self, start_time: float) -> None:
        """Make the plant and its start state from the parameters."""
        eq = self.equations
        generators = [
            Generator(*self.values(f"{prefix}.{field}" for field in ("kind", "amplitude", "frequency", "start_time")))
            for prefix in for_each_disturbance("disturbance", eq.disturbances).values()
        ]
        self.plant = Plant(equations=eq, parameters=self.values(eq.parameters), generators=generators)
        self.hidden_states = [i for i, name in enumerate(eq.states) if name not in eq.outputs]
        self.state = PlantMemory(
            plant=self.plant.init(self.values(f"{name}_start" for name in eq.states), start_time),
            held=((0.0,) * len(eq.inputs) + eq.disturbance_nominal),
        )

    def possible(self, state: PlantMemory, begin: float, now: float) -> bool:
        """Whether the plant can be in such a state now."""
        return self.plant.possible(state.plant) and same_time(state.plant.t, now) and all(map(isfinite, state.held))

    def show(self) -> Sequence[Any]:
        """Return outputs, the other states and total disturbances at the present time."""
        held = self._inputs()
        return self._outputs(self.state.plant, held)

    def advance_quickly(self, t: float, step_size: float) -> Sequence[Any] | None:
        """Take the same step if all inputs are finite: the generated code of the plant needs no NumPy then."""
        held = tuple(self.variables.present[self._inputs_at])
        if not all(map(isfinite, held)):
            return None
        return self._advanced(held, t, step_size)

    def advance(self, t: float, step_size: float) -> Sequence[Any]:
        """Integrate to the end of the step."""
        return self._advanced(self._inputs(), t, step_size)

    def _advanced(self, held: tuple[float, ...], t: float, step_size: float) -> list[float]:
        m = len(self.equations.inputs)
        after = self.plant.step(self.state.plant, held[:m], held[m:], t + step_size, step_size)
        self.state = PlantMemory(plant=after, held=held)
        return self._outputs(after, held)

    def _inputs(self) -> tuple[float, ...]:
        """Return u and d as set; a value that is not finite is replaced by the last finite one, so that x survives."""
        eq = self.equations
        given = tuple(self.values([*eq.inputs, *eq.disturbances]))
        if all(map(isfinite, given)):
            return given
        self.log("inputs that are not finite are held", Fmi2Status.warning)
        return tuple(new if isfinite(new) else old for new, old in zip(given, self.state.held, strict=True))

    def _outputs(self, state: PlantState, held: Sequence[float]) -> list[float]:
        """Return y for the input held until then, the other states, and the disturbances."""
        x, m = state.x, len(self.equations.inputs)
        outputs = self.equations.output(x, held[:m], self.plant.parameters)
        return [*outputs, *(x[i] for i in self.hidden_states), *self.plant.disturbance(state.t, held[m:])]
