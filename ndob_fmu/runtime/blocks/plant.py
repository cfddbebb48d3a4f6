"""The plant between communication points, integrated far more accurately than any observer could tell.

The substeps are tried by generated scalar code (`Equations.steps`); `step_by_definition` is what that must equal. Where
many would be needed, `numerics.stiff` takes their place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import inf, isfinite, nextafter

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.blocks.disturbance import Generator
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.generated_steps import Trial
from ndob_fmu.runtime.numerics.integrate import NODES, adapt, adapt_in_few
from ndob_fmu.runtime.numerics.stiff import Derivatives, Slopes, integrate_any, integrate_stiff

# Between the times at which the rate of a generator is taken, in parts of a step in which none of them jumps.
_DIFFERENCE = 1e-6


@dataclass  # never changed once made; frozen=True would make that cost a tenth of a step
class PlantState:
    """x (n,) at the time t (s), and the integrator's next substep (s)."""

    x: tuple[float, ...]
    t: float
    substep: float


@dataclass(frozen=True)
class Plant:
    """The plant at given parameters, with one generator for each disturbance in their order."""

    equations: Equations
    parameters: Vector
    generators: Sequence[Generator]

    def init(self, x: Vector, t: float) -> PlantState:
        """Return the state that starts from x (n,) at time t (s)."""
        return PlantState(x=tuple(map(float, x)), t=t, substep=inf)

    def possible(self, state: PlantState) -> bool:
        """Return whether numbers in the form of a state can be one."""
        return all(map(isfinite, state.x)) and isfinite(state.t) and state.substep > 0.0

    def disturbance(self, t: float, d: Vector) -> list[float]:
        """Return the whole disturbance (q2,) at t: the generators' plus the input d (q2,)."""
        return [generator(t) + value for generator, value in zip(self.generators, d, strict=True)]

    def step(self, state: PlantState, u: Vector, d: Vector, t_end: float, step_size: float | None = None) -> PlantState:
        """Advance to t_end with the inputs u (m,) and d (q2,) held and the generators running on.

        step_size (s) is what t_end − t would be without the rounding of times, which an observer of high gain shows.
        Raises IntegrationError where the solution leaves the finite numbers or needs too small substeps.
        """
        constants = self._constants
        if constants is None:
            return self.step_by_definition(state, u, d, t_end, step_size)
        x, substep = state.x, state.substep
        for begin, end, duration in self._stretches(state.t, t_end, step_size):
            trial = self._trial(u, d, constants, begin, end, duration)
            explicit = adapt_in_few(trial, x, duration, substep)
            if explicit is not None:
                x, substep = explicit
                continue
            rates, slopes = self._derivatives(u, d, begin, end), self._slopes(u, d, begin, end)
            after = integrate_stiff(rates, slopes, np.array(x), duration)
            x, substep = adapt(trial, x, 0.0, duration, substep) if after is None else (tuple(after.tolist()), substep)
        return PlantState(x=x, t=t_end, substep=substep)

    def step_by_definition(
        self, state: PlantState, u: Vector, d: Vector, t_end: float, step_size: float | None = None
    ) -> PlantState:
        """Do what `step` does, for its tests and for parameters at which the generated code cannot be prepared."""
        x, substep = np.array(state.x), state.substep
        for begin, end, duration in self._stretches(state.t, t_end, step_size):
            rates, slopes = self._derivatives(u, d, begin, end), self._slopes(u, d, begin, end)
            x, substep = integrate_any(rates, slopes, x, duration, substep)
        return PlantState(x=tuple(x.tolist()), t=t_end, substep=substep)

    def _stretches(self, t: float, t_end: float, step_size: float | None) -> list[tuple[float, float, float]]:
        """Return begin, end and duration of the parts of a step in which the generators do not jump."""
        breaks = sorted({b for g in self.generators for b in g.breaks if t < b < t_end})
        if not breaks:
            return [(t, t_end, t_end - t if step_size is None else step_size)]
        return [(begin, end, end - begin) for begin, end in pairwise((t, *breaks, t_end))]

    @cached_property
    def _constants(self) -> tuple[float, ...] | None:
        try:
            return self.equations.steps.plant_constants(self.parameters)
        except (ArithmeticError, ValueError):
            return None

    def _trial(
        self, u: Vector, d: Vector, constants: tuple[float, ...], begin: float, end: float, duration: float
    ) -> Callable[[float, tuple[float, ...], float], Trial]:
        """Return the generated trial of a substep as `adapt` wants it, in the time since `begin`."""
        # As in `_derivatives` and `integrate`.
        last, last_since = nextafter(end, begin), nextafter(duration, 0.0)
        plant_trial = self.equations.steps.plant_trial

        def trial(since: float, x: tuple[float, ...], h: float) -> Trial:
            total: list[float] = []
            for node in NODES:
                total += self.disturbance(min(begin + min(since + node * h, last_since), last), d)
            return plant_trial(x, u, total, constants, h)

        return trial

    def _derivatives(self, u: Vector, d: Vector, begin: float, end: float) -> Derivatives:
        """Return ẋ as a function of the time since `begin` and x (n,); d has not yet jumped at `end`."""
        last_inside = nextafter(end, begin)

        def derivatives(since: float, x: Array) -> Array:
            total = self.disturbance(min(begin + since, last_inside), d)
            return np.array(self.equations.derivatives(x.tolist(), u, total, self.parameters), dtype=float)

        return derivatives

    def _slopes(self, u: Vector, d: Vector, begin: float, end: float) -> Slopes:
        """Return ∂ẋ/∂x (n,n) and ∂ẋ/∂t (n,) as functions of the time since `begin` and x (n,)."""
        last_inside, apart = nextafter(end, begin), _DIFFERENCE * (end - begin)

        def slopes(since: float, x: Array) -> tuple[Array, Array]:
            t = min(begin + since, last_inside)
            before, after = max(begin, t - apart), min(last_inside, t + apart)
            change = np.subtract(self.disturbance(after, d), self.disturbance(before, d))
            d_rate = change / (after - before) if after > before else 0.0 * change
            return self.equations.slopes(x.tolist(), u, self.disturbance(t, d), d_rate, self.parameters)

        return slopes
