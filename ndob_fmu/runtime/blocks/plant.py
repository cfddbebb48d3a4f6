"""The plant between communication points, integrated far more accurately than any observer could tell.

The substeps are tried by generated scalar code (`Equations.steps`); `step_by_definition` is what that must equal. Where
many would be needed, `numerics.stiff` takes their place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite, nextafter

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.blocks.disturbance import Generator
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.numerics.integrate import NODES, adapt, adapt_in_few
from ndob_fmu.runtime.numerics.sliding import all_on
from ndob_fmu.runtime.numerics.stiff import integrate_any, integrate_stiff

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
        x, substep, begin = state.x, state.substep, state.t
        whole = t_end - begin
        if step_size is not None:
            whole = step_size
        while begin < t_end:
            end = self._end_of_stretch(begin, t_end)
            duration = whole if begin == state.t and end == t_end else end - begin
            x, substep = self._across(x, substep, u, d, constants, begin, end, duration)
            begin = end
        return PlantState(x=x, t=t_end, substep=substep)

    def step_by_definition(
        self, state: PlantState, u: Vector, d: Vector, t_end: float, step_size: float | None = None
    ) -> PlantState:
        """Do what `step` does, for its tests and for parameters at which the generated code cannot be prepared."""
        x, substep, begin = np.array(state.x), state.substep, state.t
        whole = t_end - begin
        if step_size is not None:
            whole = step_size
        while begin < t_end:
            end = self._end_of_stretch(begin, t_end)
            duration = whole if begin == state.t and end == t_end else end - begin
            x, substep = self._across_by_definition(x, substep, u, d, begin, end, duration)
            begin = end
        return PlantState(x=tuple(x.tolist()), t=t_end, substep=substep)

    def _end_of_stretch(self, begin: float, t_end: float) -> float:
        """Return the first time after `begin` at which a generator jumps; t_end if none does before that."""
        end = t_end
        for generator in self.generators:
            for time in generator.breaks:
                if begin < time < end:
                    end = time
        return end

    def _across(
        self,
        x: tuple[float, ...],
        substep: float,
        u: Vector,
        d: Vector,
        constants: tuple[float, ...],
        begin: float,
        end: float,
        duration: float,
    ) -> tuple[tuple[float, ...], float]:
        """Return x at the end of a stretch without jumps, and the explicit substep to try next."""
        # As in `_rates` and `integrate`.
        last, last_since = nextafter(end, begin), nextafter(duration, 0.0)
        plant_trial = self.equations.steps.plant_trial

        def trial(since: float, start: tuple[float, ...], h: float) -> tuple[tuple[float, ...], float]:
            total: list[float] = []
            for node in NODES:
                total += self.disturbance(min(begin + min(since + node * h, last_since), last), d)
            tried = plant_trial(start, u, total, constants, h)
            return tried.x, tried.error_norm

        jumps = self.equations.surfaces is not None
        if jumps and all_on(self._surfaces(u, np.array(x)), np.array(x)):
            after, substep = self._across_by_definition(np.array(x), substep, u, d, begin, end, duration)
            return tuple(after.tolist()), substep
        explicit = adapt_in_few(trial, x, 0.0, duration, substep, stops=jumps)
        if explicit is not None:
            x, since, planned = explicit
            if since == duration:
                return x, planned
            after, substep = self._across_by_definition(np.array(x), substep, u, d, begin, end, duration, since)
            return tuple(after.tolist()), substep

        def rates(since: float, start: Array) -> Array:
            return self._rates(u, d, begin, end, since, start)

        def slopes(since: float, start: Array) -> tuple[Array, Array]:
            return self._slopes(u, d, begin, end, since, start)

        stiff = integrate_stiff(rates, slopes, np.array(x), duration)
        if stiff is None:
            return adapt(trial, x, 0.0, duration, substep)
        return tuple(stiff.tolist()), substep

    def _across_by_definition(
        self,
        x: Array,
        substep: float,
        u: Vector,
        d: Vector,
        begin: float,
        end: float,
        duration: float,
        since: float = 0.0,
    ) -> tuple[Array, float]:
        """Return what `_across` does from a time since `begin` on, without generated code."""

        def rates(since: float, start: Array) -> Array:
            return self._rates(u, d, begin, end, since, start)

        def slopes(since: float, start: Array) -> tuple[Array, Array]:
            return self._slopes(u, d, begin, end, since, start)

        def surfaces(x: Array) -> Array:
            return self._surfaces(u, x)

        return integrate_any(rates, slopes, surfaces, x, duration, substep, since)

    @cached_property
    def _constants(self) -> tuple[float, ...] | None:
        try:
            return self.equations.steps.plant_constants(self.parameters)
        except (ArithmeticError, ValueError):
            return None

    def _rates(self, u: Vector, d: Vector, begin: float, end: float, since: float, x: Array) -> Array:
        """Return ẋ at x (n,) at a time since `begin`; d has not yet jumped at `end`."""
        total = self.disturbance(min(begin + since, nextafter(end, begin)), d)
        return np.array(self.equations.derivatives(x.tolist(), u, total, self.parameters), dtype=float)

    def _surfaces(self, u: Vector, x: Array) -> Array:
        """Return [g, ∂g/∂x] (k,1 + n) at x (n,)."""
        return self.equations.surfaces_at(x.tolist(), u, self.parameters)

    def _slopes(self, u: Vector, d: Vector, begin: float, end: float, since: float, x: Array) -> tuple[Array, Array]:
        """Return ∂ẋ/∂x (n,n) and ∂ẋ/∂t (n,) at x (n,) at a time since `begin`."""
        last_inside, apart = nextafter(end, begin), _DIFFERENCE * (end - begin)
        t = min(begin + since, last_inside)
        first, second = max(begin, t - apart), min(last_inside, t + apart)
        change = np.subtract(self.disturbance(second, d), self.disturbance(first, d))
        d_rate = change / (second - first) if second > first else 0.0 * change
        return self.equations.slopes(x.tolist(), u, self.disturbance(t, d), d_rate, self.parameters)
