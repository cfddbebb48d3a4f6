"""The disturbance order r = 0, the paper's own design: d is white noise to the filter, and read from its innovations.

d̂ = M_H S_∞ S⁻¹ e        an innovation counts by its covariance S against that of the converged filter
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.augmented import discretise
from ndob_fmu.runtime.design.stationary_design import scaled_noise
from ndob_fmu.runtime.design.step_designs import StepDesign
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.numerics.kalman import triangular
from ndob_fmu.runtime.step.converged_step import steady_after
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import SampledObserverState
from ndob_fmu.runtime.step.measurement_update import Measured
from ndob_fmu.runtime.step.observer import Estimate, numbers
from ndob_fmu.runtime.step.reconsider import measured_or_reconsidered
from ndob_fmu.runtime.step.sensor_memory import at_end_of_step, is_in_time
from ndob_fmu.runtime.step.time_update import predict_mean
from ndob_fmu.runtime.step.tracking_step import consistency


def step_of_order_zero(
    model: FilterModel, state: SampledObserverState, y: Vector, H: float, design: StepDesign
) -> tuple[SampledObserverState, Estimate, Measured]:
    """Advance by H > 0 s from a sample y (p,), with the state's input held over the step.

    Raises IntegrationError where the estimate leaves the finite numbers.
    """
    layout, stationary = model.layout, design.stationary
    xi = np.array(layout.unpacked(state.xi_hat))
    measured, memory = measured_or_reconsidered(model, xi, state, y)
    d_hat, d_std = np.array(state.d_hat), np.array(state.d_std)
    whole = all(measured.used)
    if whole:
        d_hat = _read(model, memory.columns.factor, np.array(measured.prediction.innovation), design)
        d_std = design.disturbance_std
    else:
        # What d may do meanwhile counts like the bias of `tuning.steady_std`.
        d_std = d_std + design.known.disturbance_rate * H / np.sqrt(3.0)
    d_std = np.minimum(d_std, model.bound)
    # The corrections K e carry all of d, so that only a step without one needs it.
    after = predict_mean(model, measured.xi, state.u, H, np.zeros(layout.q) if whole else d_hat)
    discrete, noise = stationary.discrete, stationary.noise_factor
    if discrete.H != H:
        discrete = discretise(stationary.system, H, stationary.alpha)
        noise = scaled_noise(discrete, stationary.intensities)
    factor = triangular(np.hstack([discrete.filter_phi @ measured.columns.factor, noise]))
    sensors = tuple(at_end_of_step(sensor, H) for sensor in measured.sensors)
    lost = memory.lost and memory.age < model.start_samples
    result = SampledObserverState(
        xi_hat=layout.packed(after),
        d_hat=numbers(d_hat),
        d_std=numbers(d_std),
        u=state.u,
        innovation=tuple(measured.prediction.innovation),
        sample=measured.sample,
        squares=measured.squares,
        memory=replace(
            memory,
            columns=memory.columns.with_factor(factor),
            sensors=sensors,
            age=min(memory.age + 1, model.start_samples),
            lost=lost,
            converged=False,
            step=H,
            steady=steady_after(memory, measured, H),
        ),
    )
    return (
        result,
        Estimate(
            x_hat=numbers(after[: layout.n]),
            d_hat=result.d_hat,
            x_at_sample=numbers(measured.xi[: layout.n]),
            d_at_sample=result.d_hat,
            d_std=result.d_std,
            d_lagged=result.d_hat,
            d_lagged_std=result.d_std,
            residual=result.innovation,
            residual_std=tuple(measured.prediction.std),
            valid=is_in_time(sensors) and not lost,
            consistency=consistency(result.squares),
        ),
        measured,
    )


def _read(model: FilterModel, factor: Array, innovation: Array, design: StepDesign) -> Array:
    """Return d̂ (q2,) after an update of a covariance with this factor (n,n)."""
    stationary = design.stationary
    assert stationary.M_H is not None
    seen = stationary.system.C @ factor
    S = seen @ seen.T + np.diag(model.noise_variance)
    converged = stationary.update.innovation_factor @ stationary.update.innovation_factor.T
    return np.asarray(stationary.M_H @ converged @ np.linalg.solve(S, innovation))
