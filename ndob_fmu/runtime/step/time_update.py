"""The time update: ξ̂ and its covariance from a sample to the end of the step.

ẋ = F(x, u) + G_d(x, u) d by the plant's equations, d continued by its Taylor series;   S ← [Φ S, N]

Φ and N belong to ẋ linearised at ξ̂ (`transition`). While ξ̂ is far off, after the start, what that leaves out counts as
noise: the second moment of the quadratic terms.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector
from ndob_fmu.runtime.generated_steps import ConvergedGain
from ndob_fmu.runtime.numerics.kalman import triangular
from ndob_fmu.runtime.numerics.stiff import integrate_any
from ndob_fmu.runtime.numerics.transition import sampled
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.layout import Layout

# E (z²/2)² = 3/4 for a normal number z.
_SECOND_ORDER = float(np.sqrt(0.75))


# Where ẋ's slopes change by more than this part of 1/H over a step, the step is taken in parts.
_STRAIGHT = 0.2
_MOST_PARTS = 8


def predict(
    model: FilterModel, xi: Array, factor: Array, u: Vector, H: float, intensity: Array, *, starting: bool
) -> tuple[Array, Array, Array, Array]:
    """Return ξ̂⁻ (N + past,), the factor (N + past,N + past) and Φ (N,N) a step H (s) later.

    The fourth result (N + past,4 q2) are the responses there to jumps of d within the step.

    intensity (q2,): of the noise behind the r-th derivative of d
    starting: whether ξ̂ may be far off
    """
    channel = _noise_channel(model, intensity, H)
    end = predict_mean(model, xi, u, H)
    F, F_end = model.slopes(xi, u).F, model.slopes(end, u).F
    change = float(np.max(np.sum(np.abs(F_end - F), axis=0))) * H
    if not change <= _STRAIGHT:
        parts = int(min(np.ceil(change / _STRAIGHT), _MOST_PARTS)) if np.isfinite(change) else _MOST_PARTS
        whole, jumps = np.eye(len(F)), model.jumps_in_step(0.5 * (F + F_end), H)
        for _ in range(parts):
            end = predict_mean(model, xi, u, H / parts)
            F_end = model.slopes(end, u).F
            Phi, factor = _predict_factor(
                model, xi, factor, u, H / parts, channel, 0.5 * (F + F_end), starting=starting
            )
            whole, xi, F = Phi @ whole, end, F_end
        return end, factor, whole, jumps
    Phi, factor = _predict_factor(model, xi, factor, u, H, channel, 0.5 * (F + F_end), starting=starting)
    return end, factor, Phi, model.jumps_in_step(0.5 * (F + F_end), H)


def _predict_factor(
    model: FilterModel, xi: Array, factor: Array, u: Vector, H: float, channel: Array, F: Array, *, starting: bool
) -> tuple[Array, Array]:
    N = model.layout.size
    Phi, noise = sampled(F, channel, H)
    if starting:
        noise = np.hstack([noise, left_out(model, xi, factor, u, H)])
    columns = factor.shape[1]
    whole = np.zeros((model.rows, columns + noise.shape[1] + model.rows))
    whole[:, :columns] = factor
    whole[:N, :columns] = Phi @ factor[:N]
    whole[:N, columns : columns + noise.shape[1]] = noise
    return Phi, triangular(whole)


def _noise_channel(model: FilterModel, intensity: Array, H: float) -> Array:
    """Return the channel (N,·) of white noise of intensity one."""
    layout = model.layout
    columns = [layout.last_derivative * np.sqrt(intensity)]
    of_states = np.sqrt(np.array(model.settings.state_noise) ** 2 + model.undriven * H)
    noisy = np.flatnonzero(of_states)
    if len(noisy):
        columns.append(np.eye(layout.size)[:, noisy] * of_states[noisy])
    return np.hstack(columns)


def predict_mean(model: FilterModel, xi: Array, u: Vector, H: float, held: Array | None = None) -> Array:
    """Return ξ̂⁻ (N + past,) a step H (s) after ξ̂; `held` (q2,): d over the step for r = 0.

    Raises IntegrationError where it leaves the finite numbers."""
    layout, eq = model.layout, model.equations
    after = xi.copy()
    parameters = model.with_parameters(xi)
    packed = layout.packed(xi[: layout.size])
    if held is not None:
        packed = (*packed[: layout.n], *held.tolist(), *packed[layout.n + layout.q :])
    done = None
    try:
        constants = eq.steps.observer_constants(parameters)
        nothing = (0.0,) * len(eq.outputs)
        done = eq.steps.observer_step(
            packed[: layout.n + HIGHEST_ORDER * layout.q], (*u, *nothing), nothing, constants, _no_gain(model), H
        )
    except (ArithmeticError, ValueError):
        done = None
    if done is not None:
        after[: layout.series.stop] = done.xi_hat[: layout.series.stop]
    else:
        after[: layout.series.stop] = predict_plant(eq, layout, parameters, xi, u, H, held)
    if not np.all(np.isfinite(after)):
        raise IntegrationError("the observer's estimate leaves the finite numbers")
    return np.asarray(after)


def left_out(model: FilterModel, xi: Array, factor: Array, u: Vector, H: float) -> Array:
    """Return the columns (N,·) of what the linearisation leaves out of ẋ over a step H (s), as noise.

    Second differences along sums of all columns of S, with orthogonal signs, see products of two states' errors too.
    """
    layout, eq = model.layout, model.equations
    n = layout.n

    def rate(xi: Array) -> Array:
        parameters = list(model.parameters)
        for place, index in enumerate(layout.uncertain):
            parameters[index] = float(xi[layout.parameters.start + place])
        d = xi[layout.disturbance].tolist() or [0.0] * layout.q
        try:
            return np.array(eq.derivatives(xi[:n].tolist(), u, d, parameters), dtype=float)
        except (ArithmeticError, ValueError):
            return np.full(n, np.nan)

    at = xi[: layout.size]
    centre = 2.0 * rate(at)
    lower = triangular(factor)[: layout.size, : layout.size]
    count = 1 << (layout.size - 1).bit_length()
    columns = np.zeros((layout.size, count))
    for k in range(count):
        along = lower @ _signs(k, layout.size)
        bend = rate(at + along) + rate(at - along) - centre
        columns[:n, k] = np.where(np.isfinite(bend), bend, 0.0)
    return np.asarray(_SECOND_ORDER * H / np.sqrt(count) * columns)


def _signs(k: int, size: int) -> Array:
    """Return row k of Walsh's orthogonal signs (size,)."""
    return np.array([-1.0 if (i & k).bit_count() % 2 else 1.0 for i in range(size)])


def ahead(model: FilterModel, Phi: Array, columns: Array) -> Array:
    """Return columns (N + past,·) of errors a step later."""
    N = model.layout.size
    after = columns.copy()
    after[:N] = Phi @ columns[:N]
    return np.asarray(after)


def _no_gain(model: FilterModel) -> ConvergedGain:
    p, n, q = len(model.equations.outputs), model.layout.n, model.layout.q
    return ConvergedGain(
        gate=(np.inf,) * p,
        weight=(0.0,) * p,
        d_std=(0.0,) * q,
        at_sample_std=(0.0,) * q,
        residual_std=(0.0,) * p,
        K=(0.0,) * ((n + HIGHEST_ORDER * q) * p),
    )


def predict_plant(
    eq: Equations, layout: Layout, parameters: Vector, xi: Array, u: Vector, H: float, held: Array | None
) -> Array:
    """Return x̂ and the series of d (n + r q2,) a step later, by the plant's equations."""
    n, q, r = layout.n, layout.q, layout.order
    series = xi[layout.series].reshape(r, q) if held is None else held[None]

    def taylor(rows: Array, t: float) -> Array:
        return np.asarray(sum((row * t**i / factorial(i) for i, row in enumerate(rows)), np.zeros(q)))

    def derivatives(t: float, x: Array) -> Array:
        return np.array(eq.derivatives(x.tolist(), u, taylor(series, t).tolist(), parameters), dtype=float)

    def slopes(t: float, x: Array) -> tuple[Array, Array]:
        return eq.slopes(x.tolist(), u, taylor(series, t).tolist(), taylor(series[1:], t), parameters)

    x_after, _ = integrate_any(derivatives, slopes, xi[:n], H, H)
    later = [sum((series[j] * H ** (j - i) / factorial(j - i) for j in range(i, r)), np.zeros(q)) for i in range(r)]
    return np.concatenate([x_after, *later])
