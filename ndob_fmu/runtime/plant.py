"""The plant between communication points, integrated far more accurately than any observer could tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.disturbance import Generator
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.integrate import integrate
from ndob_fmu.runtime.riccati import Array


@dataclass(frozen=True)
class PlantState:
    """x (n,) at the time t (s), and the integrator's next substep (s)."""

    x: Array
    t: float
    substep: float


@dataclass(frozen=True)
class Plant:
    """init(x₀, t₀) → state; step(state, u, d, t_end) → state. One generator per disturbance, in order."""

    equations: Equations
    parameters: Vector
    generators: Sequence[Generator]

    def init(self, x: Vector, t: float) -> PlantState:
        """Return the state that starts from x (n,) at time t."""
        return PlantState(x=np.array(x, dtype=float), t=t, substep=np.inf)

    def disturbance(self, t: float, d: Vector) -> list[float]:
        """Return the whole disturbance (q2,) at t: the generators' plus the input d (q2,)."""
        return [generator(t) + value for generator, value in zip(self.generators, d, strict=True)]

    def step(self, state: PlantState, u: Vector, d: Vector, t_end: float) -> PlantState:
        """Advance to t_end with the inputs u (m,) and d (q2,) held and the generators running on.

        Raises IntegrationError where the solution leaves the finite numbers or needs too small substeps.
        """

        def derivatives(t: float, x: Array) -> Array:
            return np.array(
                self.equations.derivatives(x.tolist(), u, self.disturbance(t, d), self.parameters), dtype=float
            )

        breaks = sorted({b for g in self.generators for b in g.breaks if state.t < b < t_end})
        x, t, substep = state.x, state.t, state.substep
        for until in [*breaks, t_end]:
            x, substep = integrate(derivatives, x, t, until, substep)
            t = until
        return PlantState(x=x, t=t_end, substep=substep)
