"""The plant between communication points, integrated far more accurately than any observer could tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

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

    def step(self, state: PlantState, u: Vector, d: Vector, t_end: float, step_size: float | None = None) -> PlantState:
        """Advance to t_end with the inputs u (m,) and d (q2,) held and the generators running on.

        step_size (s) is what t_end − t would be without the rounding of times, which an observer of high gain shows.
        Raises IntegrationError where the solution leaves the finite numbers or needs too small substeps.
        """
        breaks = sorted({b for g in self.generators for b in g.breaks if state.t < b < t_end})
        x, substep = state.x, state.substep
        for begin, end in pairwise((state.t, *breaks, t_end)):
            duration = end - begin if breaks or step_size is None else step_size
            x, substep = integrate(self._derivatives(u, d, begin, end), x, 0.0, duration, substep)
        return PlantState(x=x, t=t_end, substep=substep)

    def _derivatives(self, u: Vector, d: Vector, begin: float, end: float) -> Callable[[float, Array], Array]:
        """Return ẋ as a function of the time since `begin` and x (n,); jumps of d at `end` are not seen."""
        last_inside = np.nextafter(end, begin)

        def derivatives(since: float, x: Array) -> Array:
            total = self.disturbance(min(begin + since, last_inside), d)
            return np.array(self.equations.derivatives(x.tolist(), u, total, self.parameters), dtype=float)

        return derivatives
