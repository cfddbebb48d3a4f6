"""The plant between communication points, integrated far more accurately than any observer could tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.disturbance import Generator
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.errors import IntegrationError
from ndob_fmu.runtime.riccati import Array

_RELATIVE_TOLERANCE = 1e-11
_ABSOLUTE_TOLERANCE = 1e-12
_MOST_SUBSTEPS = 100_000

# Dormand and Prince, RK5(4)7M: nodes, stages, and the weights of the error estimate.
_C = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
_A = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_E = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


@dataclass(frozen=True)
class PlantState:
    """x (n,) at the time t (s), and the integrator's next substep (s)."""

    x: Array
    t: float
    substep: float


@dataclass(frozen=True)
class Plant:
    """init(x₀, t₀) → state; step(state, u, d, H) → state. One generator per disturbance, in order."""

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
            # At a jump the generator already has its new value; the stage at the end of the stretch needs the old one.
            x, substep = _integrate(derivatives, x, t, until, substep)
            t = until
        return PlantState(x=x, t=t_end, substep=substep)


def _integrate(
    derivatives: Callable[[float, Array], Array], x: Array, t: float, t_end: float, h: float
) -> tuple[Array, float]:
    last_inside = np.nextafter(t_end, t)
    for _ in range(_MOST_SUBSTEPS):
        remaining = t_end - t
        final = h >= remaining * (1.0 - 1e-12)
        step = remaining if final else h
        K = np.empty((7, len(x)))
        try:
            K[0] = derivatives(t, x)
            for i in range(1, 7):
                stage = x + step * (K[:i].T @ _A[i, :i])
                K[i] = derivatives(min(t + _C[i] * step, last_inside), stage)
        except (ArithmeticError, ValueError) as error:
            raise IntegrationError(f"plant at t = {t:g} s: its equations cannot be evaluated ({error})") from error
        error_norm = float(
            np.max(np.abs(step * (_E @ K)) / (_ABSOLUTE_TOLERANCE + _RELATIVE_TOLERANCE * np.abs(stage)), initial=0.0)
        )
        if not np.isfinite(error_norm):
            raise IntegrationError(f"plant at t = {t:g} s: the solution leaves the finite numbers")
        grow = min(5.0, max(0.2, 0.9 * error_norm**-0.2)) if error_norm > 0.0 else 5.0
        if error_norm > 1.0:
            h = step * min(grow, 0.9)
            continue
        x, t = stage, t + step
        if final:
            # A step cut short by the end of the interval says little against the longer one that was planned.
            return x, max(h, step * grow)
        h = step * grow
    raise IntegrationError(
        f"plant at t = {t:g} s: more than {_MOST_SUBSTEPS} substeps in one communication step; "
        "likely cause: parameters that make the plant stiff or unstable"
    )
