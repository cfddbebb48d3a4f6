"""A disturbance that acts in a direction that depends on the state: ẋ = A x + B u + G_f f(x, u) + G_d n(x, u) d.

The observers estimate the k lumped inputs w = n d through the constant columns of G_d as if they were k disturbances.
The one disturbance is then read out of them,

    d̂ = νᵀ ω̂ / ‖ν‖²,   ν_j = n_j(x̂, u) / σ_j,   ω̂_j = ŵ_j / σ_j,   std(d̂) = 1 / ‖ν‖,

the least-squares solution of n d = ŵ, each ŵ_j weighed by its error bar σ_j; where these are equal, nᵀ ŵ / ‖n‖². Where
n, measured in the bounds n̄_j of its entries, is shorter than 0.1, the disturbance hardly moves the plant and cannot be
told: d̂ is held at the last one read, its error bar is D₀, and it is not valid.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Channel, Equations, Vector, lumped_names
from ndob_fmu.runtime.step.observer import Estimate, numbers

VANISHING = 0.1
_SMALLEST_SHARE = 1e-9  # of the largest error bar: none is so small that it would count for all


class Observer(Protocol):
    """What the observers of both methods do; their states have the last finite input as `u` (m,)."""

    def init(self, x_hat: Vector) -> Any:
        """Return the state that starts from x̂₀ (n,)."""

    def possible(self, state: Any, elapsed: float) -> bool:
        """Return whether numbers in the form of a state can be one, `elapsed` s after the start."""

    def estimate(self, state: Any, y: Vector) -> Estimate:
        """Return what is known at a sample y (p,) before any step from it."""

    def step(self, state: Any, u: Vector, y: Vector, H: float) -> tuple[Any, Estimate]:
        """Advance by H > 0 s from a sample y (p,), with the input u (m,) held over the step."""


def lumped(equations: Equations) -> Equations:
    """Return the plant with the k lumped inputs w in place of the disturbance: itself where there is no channel."""
    channel = equations.channel
    if channel is None:
        return equations
    order = equations.observer.disturbance_order
    return replace(
        equations,
        disturbances=lumped_names(equations.disturbances[0], len(channel.bound)),
        disturbance_bound=tuple(lumped_bound(equations, equations.disturbance_bound)),
        disturbance_rate=tuple(
            lumped_rate(equations, equations.disturbance_bound, equations.disturbance_rate, order=order)
        ),
        derivatives=channel.derivatives,
        channel=None,
    )


def lumped_bound(equations: Equations, bound: Vector) -> Vector:
    """Return the bounds of |w_j|, n̄_j D₀ (k,), for the bound D₀ (1,) of |d|."""
    if equations.channel is None:
        return bound
    return [n_bound * bound[0] for n_bound in equations.channel.bound]


def lumped_rate(equations: Equations, bound: Vector, rate: Vector, *, order: int) -> Vector:
    """Return the bounds of the r-th derivative of w_j (k,), for D_r (1,) that of d; of the first for r = 0.

    With the derivatives of d in between bounded as those of a sine, D_i = D₀ (D_r/D₀)^{i/r}, Leibniz' rule gives
    |w_j^{(r)}| ≤ n̄_j Σ_i (r over i) Ω^{r−i} D_i = n̄_j (Ω D₀^{1/r} + D_r^{1/r})^r. What is unknown (0) stays so, and
    what makes no sense (< 0) is left to whoever judges it.
    """
    if equations.channel is None:
        return rate
    r, of_w = max(order, 1), rate[0]
    if rate[0] > 0.0 and bound[0] > 0.0:
        of_w = (equations.channel.rate * bound[0] ** (1.0 / r) + rate[0] ** (1.0 / r)) ** r
    return [n_bound * of_w for n_bound in equations.channel.bound]


def read_out(
    equations: Equations, parameters: Vector, observer: Observer, *, disturbance_bound: Vector
) -> Observer | ChannelObserver:
    """Return an observer of `lumped(equations)` as one of the disturbance: unchanged where there is no channel.

    disturbance_bound: D₀ (1,), the error bar of a disturbance that cannot be told.
    """
    if equations.channel is None:
        return observer
    return ChannelObserver(
        channel=equations.channel,
        parameters=parameters,
        observer=observer,
        disturbance_bound=np.array(disturbance_bound, dtype=float),
    )


@dataclass(frozen=True)
class ChannelState:
    """The state of the observer of w, and the last disturbance (1,) that could be read."""

    lumped: Any
    d_hat: Vector


@dataclass(frozen=True)
class ChannelObserver:
    """init(x̂₀) → state; step(state, u, y, H) → (state, estimate): that of `observer`, with d in place of w."""

    channel: Channel
    parameters: Vector
    observer: Observer
    disturbance_bound: Array = field(repr=False)

    def init(self, x_hat: Vector) -> ChannelState:
        """Return the state that starts from x̂₀ (n,)."""
        return ChannelState(lumped=self.observer.init(x_hat), d_hat=(0.0,))

    def possible(self, state: ChannelState, elapsed: float) -> bool:
        """Return whether numbers in the form of a state can be one, `elapsed` s after the start."""
        return bool(np.all(np.isfinite(state.d_hat))) and self.observer.possible(state.lumped, elapsed)

    def estimate(self, state: ChannelState, y: Vector) -> Estimate:
        """Return what is known at a sample y (p,) before any step from it."""
        return self._read(self.observer.estimate(state.lumped, y), state.lumped.u, state.d_hat)

    def step(self, state: ChannelState, u: Vector, y: Vector, H: float) -> tuple[ChannelState, Estimate]:
        """Advance by H > 0 s from a sample y (p,), with the input u (m,) held over the step."""
        after, estimate = self.observer.step(state.lumped, u, y, H)
        estimate = self._read(estimate, after.u, state.d_hat)
        return ChannelState(lumped=after, d_hat=estimate.d_hat), estimate

    def _read(self, lumped: Estimate, u: Vector, held: Vector) -> Estimate:
        """Return the estimate of d in place of that of w; what cannot be read is the last that could."""
        at_sample = self._direction(lumped.x_at_sample, u)
        ahead = self._direction(lumped.x_hat, u)
        # The errors of the ŵ_j are taken for independent, and x̂ for so exact that it does not turn n by much.
        w_std = np.array(lumped.d_std)
        sigma = np.maximum(w_std, _SMALLEST_SHARE * (np.max(w_std) or 1.0))
        d_at_sample, d_hat, d_std = held, held, numbers(self.disturbance_bound)
        if at_sample is not None:
            d_at_sample = d_hat = _least_squares(at_sample / sigma, lumped.d_at_sample / sigma)
        if ahead is not None:
            d_hat = _least_squares(ahead / sigma, lumped.d_hat / sigma)
            d_std = (float(1.0 / np.linalg.norm(ahead / sigma)),)
        return replace(
            lumped,
            d_hat=d_hat,
            d_at_sample=d_at_sample,
            d_std=d_std,
            valid=lumped.valid and at_sample is not None and ahead is not None,
        )

    def _direction(self, x_hat: Vector, u: Vector) -> Array | None:
        """Return n (k,); None where it vanishes or cannot be evaluated."""
        try:
            n = np.array(self.channel.direction(x_hat, u, self.parameters), dtype=float)
        except (ArithmeticError, ValueError):
            return None
        return n if VANISHING <= np.linalg.norm(n / self.channel.bound) < np.inf else None


def _least_squares(nu: Array, omega: Array) -> tuple[float]:
    """Return the d (1,) that solves ν d = ω best."""
    return (float(nu @ omega / (nu @ nu)),)
