"""A log as a linear record: the plant's equations about a trajectory of the estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ndob_fmu.log.events import Jumps
from ndob_fmu.log.smoother import LinearRecord
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.error_columns import joined
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.time_update import predict

# A jump may be as large as from one bound to the other. Inside a step it stands as jumps at three instants, as in
# `jump_bank`.
_VARIANCE = 2.0
_SHARES = np.array([5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0])


@dataclass(frozen=True)
class Samples:
    """What was measured, at K instants.

    step (K-1,): to the next instant (s)
    inputs (K,m), outputs (K,p): held until the next one; NaN where nothing was measured
    noise_variance (K,p): of each sample
    """

    step: Array
    inputs: Array
    outputs: Array
    noise_variance: Array


@dataclass(frozen=True)
class Start:
    """What is known before the first sample: ξ̂ (N,) and a factor (N,N) of its covariance."""

    xi: Array
    factor: Array


def record_along(
    model: FilterModel, samples: Samples, trajectory: Array, intensity: Callable[[float], Array], start: Start
) -> tuple[LinearRecord, Jumps]:
    """Return a record about a trajectory ξ (K,N), and the columns of jumps of d at each instant.

    intensity: of the noise behind the r-th derivative of d (q2,), for a step (s)
    start: what is known before the first sample

    Raises IntegrationError where the equations cannot be followed along a step.
    """
    K, N = trajectory.shape
    p = samples.outputs.shape[1]
    Phi, noise, shift = np.empty((K - 1, N, N)), np.empty((K - 1, N, N)), np.empty((K - 1, N))
    rows, misfit = np.empty((K, p, N)), np.empty((K, p))
    nothing = joined(np.zeros((N, N)), np.zeros((N, 0)), np.zeros((N, 0)))
    in_step = np.zeros((K, N, len(_SHARES) * model.layout.q))
    for k, xi in enumerate(trajectory):
        # A sample belongs to the input until then, which outputs with feed-through show.
        before = samples.inputs[max(k - 1, 0)].tolist()
        rows[k] = model.output_slopes(xi, before)
        misfit[k] = samples.outputs[k] - model.predicted_output(xi, before)
        if k < K - 1:
            H, u = float(samples.step[k]), samples.inputs[k].tolist()
            end = predict(model, xi, nothing, u, H, intensity(H), starting=False)
            Phi[k], noise[k], shift[k] = end.Phi, end.columns.factor, end.xi - trajectory[k + 1]
            in_step[k + 1] = np.concatenate(list(end.jumps[1:] * np.sqrt(_VARIANCE * _SHARES)[:, None, None]), axis=1)
    record = LinearRecord(
        Phi, noise, shift, rows, misfit, samples.noise_variance, start.xi - trajectory[0], start.factor
    )
    bounds = np.tile(model.bound, len(_SHARES))
    at_sample = np.sqrt(_VARIANCE) * model.jump_channel * model.bound
    return record, Jumps(np.broadcast_to(at_sample, (K, *at_sample.shape)), in_step * bounds)
