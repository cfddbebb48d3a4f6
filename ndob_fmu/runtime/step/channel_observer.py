"""One disturbance d read out of the lumped inputs w = n(x, u) d, which an observer estimates like k disturbances.

    d̂ = νᵀ ω̂ / ‖ν‖²,   ν_j = n_j(x̂, u) / σ_j,   ω̂_j = ŵ_j / σ_j,   std(d̂) = 1 / ‖ν‖

This is the least-squares solution of n d = ŵ, with each ŵ_j weighed by its error bar σ_j. Where n, measured in the
bounds n̄_j of its entries, is shorter than 0.1, the disturbance hardly moves the plant and cannot be told. There d̂ is
held at the last value read, its error bar is D₀, and it is not valid.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Channel, Equations, Vector
from ndob_fmu.runtime.step.filter_state import LagMemory
from ndob_fmu.runtime.step.fixed_lag import at_lag, empty_lag, is_due, later, remembered
from ndob_fmu.runtime.step.observer import Estimate, Observer, S, numbers

VANISHING = 0.1
_SMALLEST_SHARE = 1e-9  # of the largest error bar: a smaller error bar would give its ŵ_j all the weight


def read_out(
    equations: Equations, parameters: Vector, observer: Observer[S], *, disturbance_bound: Vector, lag: float = 0.0
) -> Observer[S] | ChannelObserver[S]:
    """Return the observer of the disturbance, for an `observer` of `design.lumping.lumped(equations)`.

    It is `observer` itself where there is no channel.

    disturbance_bound (1,): D₀, the error bar of a disturbance that cannot be told
    lag: of the lagged estimate of w (s)
    """
    if equations.channel is None:
        return observer
    bound = np.array(disturbance_bound, dtype=float)
    return ChannelObserver(observer, ChannelReading(equations.channel, parameters, bound, lag))


@dataclass(frozen=True)
class ChannelState(Generic[S]):
    """What the observer of a disturbance in a channel remembers.

    lumped: the state of the observer of w.
    d_hat (1,): the last disturbance that could be read.
    directions: n at past samples, as far back as the lag; empty without one.
    """

    lumped: S
    d_hat: Vector
    directions: LagMemory

    @property
    def u(self) -> Vector | Array:
        """The last finite input (m,)."""
        return self.lumped.u


@dataclass(frozen=True)
class ChannelReading:
    """How d is read out of estimates of the lumped inputs w.

    disturbance_bound (1,): D₀, the error bar of a d̂ that cannot be told
    lag: of the lagged estimate of w (s)
    """

    channel: Channel
    parameters: Vector
    disturbance_bound: Array = field(repr=False)
    lag: float = 0.0

    def read(self, lumped: Estimate, u: Vector, held: Vector, directions: LagMemory) -> tuple[Estimate, LagMemory]:
        """Return the estimate of d in place of that of w, and the directions with the one at this sample.

        held (1,): the last disturbance that could be read

        The errors of the ŵ_j are treated as independent, and x̂ as exact enough not to turn n.
        """
        at_sample = self._direction(lumped.x_at_sample, u)
        ahead = self._direction(lumped.x_hat, u)
        d_at_sample, _ = self._fit(at_sample, lumped.d_at_sample, lumped.d_std, held)
        d_hat, d_std = self._fit(ahead, lumped.d_hat, lumped.d_std, d_at_sample)
        then = at_sample
        if self.lag > 0.0:
            k = len(self.channel.bound)
            n = np.zeros(k) if at_sample is None else at_sample
            if is_due(directions, self.lag):
                directions = remembered(directions, n, np.zeros(k), np.zeros((k, 0)))
            then = self._if_long_enough(at_lag(directions, self.lag, k)[0])
        d_lagged, d_lagged_std = self._fit(then, lumped.d_lagged, lumped.d_lagged_std, held)
        read = replace(
            lumped,
            d_hat=d_hat,
            d_at_sample=d_at_sample,
            d_std=d_std,
            d_lagged=d_lagged,
            d_lagged_std=d_lagged_std,
            valid=lumped.valid and at_sample is not None and ahead is not None,
        )
        return read, directions

    def _fit(self, n: Array | None, w: Vector, w_std: Vector, held: Vector) -> tuple[Vector, Vector]:
        """Return d̂ (1,) and its error bar (1,) from ŵ (k,) and its own; `held` and D₀ where n (k,) tells nothing."""
        if n is None:
            return held, numbers(self.disturbance_bound)
        std = np.array(w_std)
        sigma = np.maximum(std, _SMALLEST_SHARE * (np.max(std) or 1.0))
        return _least_squares(n / sigma, w / sigma), (float(1.0 / np.linalg.norm(n / sigma)),)

    def _direction(self, x_hat: Vector, u: Vector) -> Array | None:
        """Return n (k,); None where it vanishes or cannot be evaluated."""
        try:
            n = np.array(self.channel.direction(x_hat, u, self.parameters), dtype=float)
        except (ArithmeticError, ValueError):
            return None
        return self._if_long_enough(n)

    def _if_long_enough(self, n: Array) -> Array | None:
        return n if VANISHING <= np.linalg.norm(n / self.channel.bound) < np.inf else None


@dataclass(frozen=True)
class ChannelObserver(Generic[S]):
    """The observer of d, made from an `observer` of the lumped inputs w."""

    observer: Observer[S]
    reading: ChannelReading

    def init(self, x_hat: Vector) -> ChannelState[S]:
        """Return the state that starts from x̂₀ (n,)."""
        directions = empty_lag(len(self.reading.channel.bound), self.reading.lag, 0)
        return ChannelState(lumped=self.observer.init(x_hat), d_hat=(0.0,), directions=directions)

    def possible(self, state: ChannelState[S]) -> bool:
        """Return whether numbers in the form of a state can be one."""
        own = (state.d_hat, state.directions.age, state.directions.value)
        return all(bool(np.all(np.isfinite(part))) for part in own) and self.observer.possible(state.lumped)

    def estimate(self, state: ChannelState[S], y: Vector) -> Estimate:
        """Return what is known at a sample y (p,) before any step from it."""
        lumped = self.observer.estimate(state.lumped, y)
        return self.reading.read(lumped, _numbers_of(state.lumped.u), state.d_hat, state.directions)[0]

    def step(self, state: ChannelState[S], u: Vector, y: Vector, H: float) -> tuple[ChannelState[S], Estimate]:
        """Advance by H > 0 s from a sample y (p,), with the input u (m,) held over the step."""
        after, lumped = self.observer.step(state.lumped, u, y, H)
        estimate, directions = self.reading.read(lumped, _numbers_of(after.u), state.d_hat, state.directions)
        return ChannelState(lumped=after, d_hat=estimate.d_hat, directions=later(directions, H)), estimate


def _numbers_of(u: Vector | Array) -> Vector:
    return [float(value) for value in u]


def _least_squares(nu: Array, omega: Array) -> tuple[float]:
    """Return the d (1,) that solves ν d = ω best."""
    return (float(nu @ omega / (nu @ nu)),)
