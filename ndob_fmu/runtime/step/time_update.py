"""The time update: ξ̂ and its covariance from a sample to the end of the step.

ẋ = F(x, u) + G_d(x, u) d by the plant's equations, d continued by its Taylor series;   S ← [Φ S, N]

Φ and N belong to ẋ linearised at ξ̂ (`transition`). While ξ̂ is far off, after the start, what that leaves out counts as
noise: the second moment of the quadratic terms.
"""

from __future__ import annotations

from math import factorial, isfinite
from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector
from ndob_fmu.runtime.numerics.kalman import triangular
from ndob_fmu.runtime.numerics.stiff import integrate_any
from ndob_fmu.runtime.numerics.transition import NO_PARTS, Transition, transition
from ndob_fmu.runtime.step.error_columns import ErrorColumns
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.held import projection_of, still_held
from ndob_fmu.runtime.step.jump_bank import AFTER_JUMPS
from ndob_fmu.runtime.step.layout import Layout
from ndob_fmu.runtime.step.model_error import with_model_error

# E (z²/2)² = 3/4 for a normal number z.
_SECOND_ORDER = float(np.sqrt(0.75))


# Where ẋ's slopes change by more than this part of 1/H over a step, the step is taken in parts.
_STRAIGHT = 0.2
_MOST_PARTS = 8


class Predicted(NamedTuple):
    """The end of a step.

    xi (N + past,): ξ̂⁻
    columns: as in `FilterMemory`, with a factor (N + past,N + past)
    Phi (N,N): of the step
    jumps (4,N,q2): the responses there to jumps of d within the step
    """

    xi: Array
    columns: ErrorColumns
    Phi: Array
    jumps: Array


def predict(
    model: FilterModel,
    xi: Array,
    columns: ErrorColumns,
    u: Vector,
    H: float,
    intensity: Array,
    unseen: Array,
    *,
    starting: bool,
    model_error: float,
) -> Predicted:
    """Return the end of a step H (s) that begins with ξ̂ (N + past,).

    intensity (q2,): of the noise behind the r-th derivative of d
    unseen (q2,): the variance that jumps of d add in a step in which surfaces hold the state, so that none shows
    starting: whether ξ̂ may be far off
    model_error: as in `FilterMemory`

    Raises IntegrationError where ξ̂ leaves the finite numbers.
    """
    channel = model.noise_directions * model.noise_sizes(intensity, H)
    xi = still_held(model, xi, columns, u, H)
    end = predict_mean(model, xi, u, H)
    F, F_end = model.rates(xi, u), model.rates(end, u)
    mean = 0.5 * (F + F_end)
    channel = with_model_error(model, model_error, channel, mean, xi, H)
    units = model.units(mean, H)
    projection = None if starting else projection_of(model, end, u)
    if projection is not None:
        columns, Phi, responses = _held(model, columns, mean, channel, H, units, projection, unseen)
        return Predicted(end, columns, Phi, responses)
    change = float(np.abs((F_end - F) * units / units[:, None]).sum(axis=0).max()) * H
    if change <= _STRAIGHT:
        done = transition(mean, channel, H, model.jump_channel, AFTER_JUMPS, units)
        columns = _moved(model, xi, columns, u, H, done, starting=starting)
        return Predicted(end, columns, done.Phi, done.responses)
    parts = int(min(np.ceil(change / _STRAIGHT), _MOST_PARTS)) if isfinite(change) else _MOST_PARTS
    jumps, whole = transition(mean, channel, H, model.jump_channel, AFTER_JUMPS, units).responses, np.eye(len(F))
    for _ in range(parts):
        end = predict_mean(model, xi, u, H / parts)
        F_end = model.rates(end, u)
        done = transition(0.5 * (F + F_end), channel, H / parts, model.jump_channel, NO_PARTS, units)
        columns = _moved(model, xi, columns, u, H / parts, done, starting=starting)
        whole, xi, F = done.Phi @ whole, end, F_end
    return Predicted(end, columns, whole, jumps)


def _held(
    model: FilterModel,
    columns: ErrorColumns,
    F: Array,
    channel: Array,
    H: float,
    units: Array,
    projection: Array,
    unseen: Array,
) -> tuple[ErrorColumns, Array, Array]:
    """Return columns, Φ (N,N) and the responses to jumps after a step H (s) in which surfaces hold the state.

    F (N,N): without them
    projection (N,N): Π
    unseen (q2,): as `predict` takes it

    Signatures move as without surfaces: a jump of d that takes the state off them shows as such.
    """
    N, count, jumps = model.layout.size, columns.factor_count, columns.jump_count
    free = transition(F, channel, H, model.jump_channel, AFTER_JUMPS, units)
    done = transition(projection @ F, channel, H, model.jump_channel, NO_PARTS, units)
    Phi = projection @ done.Phi
    values = columns.values.copy()
    values[:N] = Phi @ columns.values[:N]
    values[:N, count : count + jumps] = free.Phi @ columns.signatures[:N]
    noise = np.concatenate([projection @ done.noise, model.jump_channel * np.sqrt(unseen)], axis=1)
    return _with_noise(columns.with_values(values), noise), Phi, free.responses


def _moved(
    model: FilterModel, xi: Array, columns: ErrorColumns, u: Vector, H: float, done: Transition, *, starting: bool
) -> ErrorColumns:
    """Return the columns a part H (s) of a step later."""
    N, noise = model.layout.size, done.noise
    if starting and not model.is_linear:
        noise = np.concatenate([noise, left_out(model, xi, columns.factor, u, H)], axis=1)
    values = columns.values.copy()
    values[:N] = done.Phi @ columns.values[:N]
    return _with_noise(columns.with_values(values), noise)


def _with_noise(columns: ErrorColumns, noise: Array) -> ErrorColumns:
    """Return the columns with noise (N,·) of ξ in their factor."""
    count = columns.factor_count
    whole = np.zeros((len(columns.values), count + noise.shape[1]))
    whole[:, :count] = columns.factor
    whole[: len(noise), count:] = noise
    return columns.with_factor(triangular(whole))


def predict_mean(model: FilterModel, xi: Array, u: Vector, H: float, held: Array | None = None) -> Array:
    """Return ξ̂⁻ (N + past,) a step H (s) after ξ̂; `held` (q2,): d over the step for r = 0.

    Raises IntegrationError where it leaves the finite numbers."""
    layout, eq = model.layout, model.equations
    after: Array = xi.copy()
    parameters = model.with_parameters(xi)
    packed = layout.packed(xi[: layout.size])
    if held is not None:
        packed = (*packed[: layout.n], *held.tolist(), *packed[layout.n + layout.q :])
    done = None
    if not model.is_on_a_surface(xi, u):
        try:
            constants = model.step_constants(parameters)
            done = eq.steps.observer_step(
                packed[: layout.n + HIGHEST_ORDER * layout.q],
                (*u, *model.no_sample),
                model.no_sample,
                constants,
                model.no_gain,
                H,
            )
        except (ArithmeticError, ValueError):
            done = None
    if done is not None:
        after[: layout.series.stop] = done.xi_hat[: layout.series.stop]
    else:
        after[: layout.series.stop] = predict_plant(eq, layout, parameters, xi, u, H, held)
    if not np.isfinite(after).all():
        raise IntegrationError("the observer's estimate leaves the finite numbers")
    return after


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

    def surfaces(x: Array) -> Array:
        return eq.surfaces_at(x.tolist(), u, parameters)

    x_after, _ = integrate_any(derivatives, slopes, surfaces, xi[:n], H, H)
    later = [sum((series[j] * H ** (j - i) / factorial(j - i) for j in range(i, r)), np.zeros(q)) for i in range(r)]
    return np.concatenate([x_after, *later])
