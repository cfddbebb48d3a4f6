"""A step whose covariance runs along: measurement update, what is published, time update."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.step.delayed_outputs import is_kept
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, JumpBank, LagMemory, SampledObserverState, SensorMemory
from ndob_fmu.runtime.step.fixed_lag import at_lag, remembered
from ndob_fmu.runtime.step.jump_bank import with_newest
from ndob_fmu.runtime.step.measurement_update import Measured, bounded
from ndob_fmu.runtime.step.observer import Estimate, numbers
from ndob_fmu.runtime.step.reconsider import measured_or_reconsidered
from ndob_fmu.runtime.step.time_update import ahead, predict

LATE = 1.5  # the estimate counts as valid for so many of the usual intervals between samples


def step_with_covariance(
    model: FilterModel, state: SampledObserverState, y: Vector, H: float, intensity: Array
) -> tuple[SampledObserverState, Estimate, Measured]:
    """Advance by H > 0 s from a sample y (p,), with the state's input held over the step.

    intensity (q2,): of the noise behind the r-th derivative of d

    Raises IntegrationError where the estimate leaves the finite numbers.
    """
    layout, u = model.layout, state.u
    xi = np.concatenate([layout.unpacked(state.xi_hat), state.memory.past])
    measured, memory = measured_or_reconsidered(model, xi, state, y)
    xi, factor = bounded(model, measured.xi, measured.factor)

    d = layout.disturbance
    spread = measured.mixture.variance
    at_sample = xi + measured.mixture.shift
    at_sample_std = np.minimum(np.sqrt(np.sum(factor[d] ** 2, axis=1) + spread[d]), model.bound)
    lagged = remembered(measured.lagged, at_sample[d], factor[d], factor, model.settings.lag)
    d_lagged, d_lagged_std = at_sample[d], at_sample_std
    if model.settings.lag > 0.0:
        d_lagged, d_lagged_std = at_lag(lagged, model.settings.lag, layout.q)
        d_lagged_std = np.minimum(d_lagged_std, model.bound)

    jumps = measured.jumps
    past_age = memory.past_age
    if model.delayed:
        xi, factor, jumps, lagged, past_age = _with_this_sample(model, xi, factor, jumps, lagged, past_age, u, H)
    starting = memory.age < model.start_samples
    after, factor, Phi, newest = predict(model, xi, factor, u, H, intensity, starting=starting)
    published = after + ahead(model, Phi, measured.mixture.shift[:, None])[:, 0]
    spread_after = (Phi**2) @ spread[: layout.size]
    d_std = np.minimum(np.sqrt(np.sum(factor[d] ** 2, axis=1) + spread_after[d]), model.bound)

    jumps = replace(jumps, signatures=ahead(model, Phi, jumps.signatures), newest_age=min(jumps.newest_age + H, _LONG))
    if memory.age >= layout.size:
        jumps = with_newest(jumps, newest, model.jump_spacing)
    sensors = at_end_of_step(measured.sensors, H)
    lost = memory.lost and memory.age < model.start_samples
    valid = is_in_time(sensors) and not lost
    N = layout.size
    result = SampledObserverState(
        xi_hat=layout.packed(after[:N]),
        d_hat=numbers(published[d]),
        d_std=numbers(d_std),
        u=u,
        innovation=numbers(measured.innovation),
        sample=measured.sample,
        squares=measured.squares,
        memory=FilterMemory(
            factor=factor,
            past=after[N:],
            past_age=past_age,
            jumps=jumps,
            sensors=sensors,
            lagged=replace(
                lagged,
                age=np.where(lagged.age >= 0.0, lagged.age + H, -1.0),
                covariance=ahead(model, Phi, lagged.covariance),
            ),
            age=min(memory.age + 1, model.start_samples),
            lost=lost,
            converged=False,
            tuned_at=memory.tuned_at,
            step=H,
            steady=min(memory.steady + 1, model.start_samples) if memory.step == H else 0,
        ),
    )
    estimate = Estimate(
        x_hat=numbers(published[: layout.n]),
        d_hat=result.d_hat,
        x_at_sample=numbers(at_sample[: layout.n]),
        d_at_sample=numbers(at_sample[d]),
        d_std=result.d_std,
        d_lagged=numbers(d_lagged),
        d_lagged_std=numbers(d_lagged_std),
        residual=result.innovation,
        residual_std=numbers(measured.innovation_std),
        valid=valid,
        consistency=consistency(result.squares),
    )
    return result, estimate, measured


_LONG = 1e9  # s


def at_end_of_step(sensors: SensorMemory, H: float) -> SensorMemory:
    """Return the memory of the sensors a step H (s) later; before two samples the interval counts as one step."""
    interval = np.where(sensors.interval > 0.0, sensors.interval, H)
    return replace(sensors, waited=sensors.waited + H, interval=interval)


def is_in_time(sensors: SensorMemory) -> bool:
    """Return whether a sample was used within the usual interval of the slowest sensor, or not much longer ago."""
    return bool(np.min(sensors.waited) <= LATE * np.max(sensors.interval))


def consistency(squares: Vector) -> float:
    """Return the mean over the outputs of their innovations squared over the variance."""
    return sum(squares) / len(squares)


def _with_this_sample(
    model: FilterModel, xi: Array, factor: Array, jumps: JumpBank, lagged: LagMemory, ages: Array, u: Vector, H: float
) -> tuple[Array, Array, JumpBank, LagMemory, Array]:
    """Return all rows with the outputs of delayed sensors at this sample as the newest entries, and their ages."""
    if is_kept(ages, model.longest_delay):
        N, count, which = model.layout.size, len(model.delayed), list(model.delayed)
        C = model.slopes(xi, u).C[which]
        now = model.predicted_output(xi, u)[which]

        def pushed(rows: Array, newest: Array) -> Array:
            return np.concatenate([rows[:N], rows[N + count :], newest])

        xi = pushed(xi, now)
        factor = pushed(factor, C @ factor[:N])
        jumps = replace(jumps, signatures=pushed(jumps.signatures, C @ jumps.signatures[:N]))
        lagged = replace(lagged, covariance=pushed(lagged.covariance, C @ lagged.covariance[:N]))
        ages = np.append(ages[1:], 0.0)
    return xi, factor, jumps, lagged, np.where(ages >= 0.0, ages + H, -1.0)
