"""A step whose covariance runs along: measurement update, what is published, time update."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.generated_steps import Numbers
from ndob_fmu.runtime.step.converged_step import steady_after
from ndob_fmu.runtime.step.delayed_outputs import is_kept
from ndob_fmu.runtime.step.error_columns import ErrorColumns
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, SampledObserverState
from ndob_fmu.runtime.step.fixed_lag import at_lag, is_due, later, moved, remembered, with_new_signatures
from ndob_fmu.runtime.step.held import limited
from ndob_fmu.runtime.step.jump_bank import later_bank, moments, unseen_variance, with_newest
from ndob_fmu.runtime.step.measurement_update import Measured, bounded
from ndob_fmu.runtime.step.model_error import followed, is_far_beyond_bound
from ndob_fmu.runtime.step.observer import Estimate, numbers
from ndob_fmu.runtime.step.reconsider import measured_or_reconsidered
from ndob_fmu.runtime.step.sensor_memory import at_end_of_step, is_in_time
from ndob_fmu.runtime.step.time_update import predict


def step_with_covariance(
    model: FilterModel, state: SampledObserverState, u: Numbers, y: Vector, H: float, intensity: Array
) -> tuple[SampledObserverState, Estimate, Measured]:
    """Advance by H > 0 s from a sample y (p,), with the input u (m,) held over the step.

    The sample was taken while the input of the state still acted.

    intensity (q2,): of the noise behind the r-th derivative of d

    Raises IntegrationError where the estimate leaves the finite numbers.
    """
    layout = model.layout
    n, N, d = layout.n, layout.size, layout.disturbance
    xi = np.concatenate([layout.unpacked(state.xi_hat), state.memory.past])
    measured, memory = measured_or_reconsidered(model, xi, state, y)
    more = model.taken_for_disturbance(measured.xi, state.u)
    xi, columns, lagged = bounded(model, measured.xi, measured.columns, measured.lagged, more)
    xi, columns, lagged = limited(model, xi, columns, lagged, state.u)

    added = measured.mixture
    at_sample = xi
    if added.shift is not None:
        at_sample = _with_shift(model, xi, added.shift)
    d_at_sample, at_sample_std = as_published(
        model, at_sample[d], _variance_of_disturbance(model, columns, added.variance) + more
    )
    d_lagged, d_lagged_std = d_at_sample, at_sample_std
    if model.settings.lag > 0.0:
        if is_due(lagged, model.settings.lag):
            lagged = remembered(lagged, xi[d], (columns.factor[d] ** 2).sum(axis=1), columns.signatures[d])
            columns = columns.with_past(d)
        shown = lagged
        if added.shift is not None:
            shift, variance_of_past = moments(measured.jumps, lagged.signatures)
            shown = moved(lagged, shift, variance_of_past)
        d_lagged, d_lagged_std = at_lag(shown, model.settings.lag, layout.q)
        d_lagged, d_lagged_std = as_published(model, d_lagged, d_lagged_std**2 + more)
    past_age = memory.past_age
    if model.delayed:
        xi, columns, past_age = _with_this_sample(model, xi, columns, past_age, state.u, H)

    starting = memory.age < model.start_samples
    unseen = unseen_variance(measured.jumps, model.bound * model.scale)
    beyond = is_far_beyond_bound(model, xi)
    model_error = followed(model, memory.model_error, memory.age, measured.prediction, beyond=beyond)
    end = predict(model, xi, columns, u, H, intensity, unseen, starting=starting, model_error=model_error)
    published, variance = end.xi, None
    if added.shift is not None and added.variance is not None:
        published = _with_shift(
            model, published, np.concatenate([end.Phi @ added.shift[:N], np.zeros(model.past_size)])
        )
        variance = (end.Phi**2) @ added.variance[:N]
    more = model.taken_for_disturbance(end.xi, u)
    d_hat, d_std = as_published(model, published[d], _variance_of_disturbance(model, end.columns, variance) + more)

    columns, jumps = end.columns, later_bank(measured.jumps, H)
    # Where the last hypotheses are nearer than the spacing, a jump between cannot be told from them.
    if memory.age >= N and jumps.newest_age >= model.jump_spacing * (1.0 - 1e-9):
        newest = model.signatures_in_step(end.jumps)
        signatures = np.concatenate([columns.signatures[:, newest.shape[1] :], newest], axis=1)
        columns, jumps = columns.with_signatures(signatures), with_newest(jumps, model.first_sizes)
        lagged = with_new_signatures(lagged, model.signatures_at_sample)
    sensors = tuple(at_end_of_step(sensor, H) for sensor in measured.sensors)
    lost, refuted = memory.lost and starting, beyond and model_error > 0.0
    result = SampledObserverState(
        xi_hat=layout.packed(end.xi[:N]),
        d_hat=numbers(d_hat),
        d_std=numbers(d_std),
        u=u,
        innovation=tuple(measured.prediction.innovation),
        sample=measured.sample,
        squares=measured.squares,
        memory=FilterMemory(
            columns=columns,
            past=end.xi[N:],
            past_age=past_age,
            jumps=jumps,
            sensors=sensors,
            lagged=later(lagged, H),
            age=min(memory.age + 1, model.start_samples),
            lost=lost,
            converged=False,
            frozen_noise=memory.frozen_noise,
            tuned_at=memory.tuned_at,
            step=H,
            steady=steady_after(memory, measured, H),
            model_error=model_error,
        ),
    )
    estimate = Estimate(
        x_hat=numbers(published[:n]),
        d_hat=result.d_hat,
        x_at_sample=numbers(at_sample[:n]),
        d_at_sample=numbers(d_at_sample),
        d_std=result.d_std,
        d_lagged=numbers(d_lagged),
        d_lagged_std=numbers(d_lagged_std),
        residual=result.innovation,
        residual_std=tuple(measured.prediction.std),
        valid=is_in_time(sensors) and not (lost or refuted),
        consistency=consistency(result.squares),
    )
    return result, estimate, measured


def _with_shift(model: FilterModel, xi: Array, shift: Array) -> Array:
    """Return ξ̂ (N + past,) with the shift of a mixture, which does not move d̂ beyond its bound."""
    d, nominal = model.layout.disturbance, np.array(model.settings.disturbance_nominal, dtype=float)
    moved_xi: Array = xi + shift
    least, most = np.minimum(xi[d], nominal - model.bound), np.maximum(xi[d], nominal + model.bound)
    moved_xi[d] = np.minimum(np.maximum(moved_xi[d], least), most)
    return moved_xi


def _variance_of_disturbance(model: FilterModel, columns: ErrorColumns, variance: Array | None) -> Array:
    """Return the variance (q2,) of d̂, with what hypotheses of a jump add to that (N or more,) of ξ̂."""
    d = model.layout.disturbance
    total = (columns.factor[d] ** 2).sum(axis=1)
    if variance is not None:
        total = total + variance[d]
    return np.asarray(total)


def as_published(model: FilterModel, d: Array, variance: Array) -> tuple[Array, Array]:
    """Return what is published of d̂ (q2,) with a variance (q2,), and its error bar, at most D₀.

    Where considered parameters make the variance larger than D₀², the bound counts as a measurement, as in `bounded`,
    but for this value only: in ξ̂ the next sample would take it back.
    """
    if model.considers:
        nominal = np.array(model.settings.disturbance_nominal, dtype=float)
        limit = (model.bound * model.scale) ** 2
        d = nominal + (d - nominal) * (limit / np.maximum(variance, limit))
    return d, np.asarray(np.minimum(np.sqrt(variance), model.bound))


def consistency(squares: Vector) -> float:
    """Return the mean over the outputs of their innovations squared over the variance."""
    return sum(squares) / len(squares)


def _with_this_sample(
    model: FilterModel, xi: Array, columns: ErrorColumns, ages: Array, u: Vector, H: float
) -> tuple[Array, ErrorColumns, Array]:
    """Return all rows with the outputs of delayed sensors at this sample as the newest entries, and their ages."""
    if is_kept(ages, model.longest_delay):
        N, count, which = model.layout.size, len(model.delayed), list(model.delayed)
        C = model.output_slopes(xi, u)[which]
        now = np.array(model.predicted_output(xi, u))[which]

        def pushed(rows: Array, newest: Array) -> Array:
            return np.concatenate([rows[:N], rows[N + count :], newest])

        xi = pushed(xi, now)
        columns = columns.with_values(pushed(columns.values, C @ columns.values[:N]))
        ages = np.append(ages[1:], 0.0)
    return xi, columns, np.where(ages >= 0.0, ages + H, -1.0)
