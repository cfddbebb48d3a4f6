"""`<Name>Controller`: state feedback with compensation of the estimated disturbance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from pythonfmu.enums import Fmi2Status

from fmus.slave_base import Slave
from ndob_fmu.interface.controller_variables import controller_variables, gains
from ndob_fmu.runtime.blocks.controller import Controller, Feedback, Target
from ndob_fmu.runtime.equations import Equations


@dataclass(frozen=True)
class ControllerMemory:
    """The last equilibrium, and the last finite inputs."""

    target: Target
    inputs: tuple[float, ...]


class ControllerSlave(Slave):
    """Commands, for the references and estimates that a step begins with, what holds from its end on."""

    state_types = (ControllerMemory, Target)
    state: ControllerMemory

    def __init__(self, equations: Equations, feedback: Feedback, **kwargs: Any) -> None:
        self.equations, self.feedback = equations, feedback
        super().__init__(controller_variables(equations, feedback), **kwargs)

    def start(self, start_time: float) -> None:
        """Make the controller from the parameters."""
        eq = self.equations
        self.controller = Controller(
            equations=eq,
            parameters=self.values(eq.parameters),
            regulated=self.feedback.regulated,
            gain=np.reshape(self.values(gains(eq, self.feedback)), (len(eq.inputs), len(eq.states))),
            limit=np.array(self.values(f"{u}_limit" for u in eq.inputs)),
            compensation=self.value("compensation"),
        )
        self.inputs = (
            *(f"{name}_reference" for name in self.feedback.regulated),
            *(f"{name}_hat" for name in (*eq.states, *eq.disturbances)),
        )
        self.state = ControllerMemory(self.controller.start(), (0.0,) * len(self.inputs))

    def possible(self, state: ControllerMemory, begin: float, now: float) -> bool:
        """Whether the controller can be in such a state."""
        return self.controller.possible(state.target) and all(map(isfinite, state.inputs))

    def show(self) -> Sequence[Any]:
        """Return the command for the inputs set so far."""
        return self._command()

    def advance(self, t: float, step_size: float) -> Sequence[Any]:
        """Return the command for the inputs at the start of the step."""
        return self._command()

    def _command(self) -> list[Any]:
        """Return u and whether it is saturated; an input that is not finite is replaced by its last finite value."""
        given = self.values(self.inputs)
        if not all(map(isfinite, given)):
            self.log("estimates or references that are not finite are held", Fmi2Status.warning)
            given = [new if isfinite(new) else old for new, old in zip(given, self.state.inputs, strict=True)]
        m, n = len(self.equations.inputs), len(self.equations.states)
        target, u = self.controller.step(self.state.target, given[:m], given[m : m + n], given[m + n :])
        self.state = ControllerMemory(target, tuple(given))
        return [*u, self.controller.saturates(u)]
