"""The plant for the design, with k lumped inputs w = n(x, u) d in place of one disturbance d in a channel n(x, u).

    ẋ = A x + B u + G_f f(x, u) + G_d w

A plant without a channel stays as it is.
"""

from __future__ import annotations

from dataclasses import replace

from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.equations import Equations, Vector, lumped_names


def lumped(equations: Equations) -> Equations:
    """Return the plant with the k lumped inputs w in place of d; without a channel the plant itself."""
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
        disturbance_nominal=(0.0,) * len(channel.bound),
        derivatives=channel.derivatives,
        linearisation=channel.linearisation,
        input_slopes=channel.input_slopes,
        sensitivity=channel.sensitivity,
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
    |w_j^{(r)}| ≤ n̄_j Σ_i (r over i) Ω^{r−i} D_i = n̄_j (Ω D₀^{1/r} + D_r^{1/r})^r. An unknown rate (0) stays 0. A
    negative rate or bound is passed on, for `sampled_observer` to refuse.
    """
    if equations.channel is None:
        return rate
    r, of_w = max(order, 1), rate[0]
    if rate[0] > 0.0 and bound[0] > 0.0:
        of_w = (equations.channel.rate * bound[0] ** (1.0 / r) + rate[0] ** (1.0 / r)) ** r
    return [n_bound * of_w for n_bound in equations.channel.bound]


def lumped_nominal(equations: Equations, nominal: Vector) -> Vector:
    """Return the nominal values of w (k,), which are 0. Raises DesignError where that of d (1,) is another."""
    if equations.channel is None:
        return nominal
    if nominal[0] != 0.0:
        raise DesignError.report("disturbance_nominal", expected="0 with a channel", received=f"{nominal[0]:g}")
    return [0.0 for _ in equations.channel.bound]
