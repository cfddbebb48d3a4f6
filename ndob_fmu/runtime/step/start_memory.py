"""What the sampled-data observer remembers before the first sample."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.error_columns import ErrorColumns, joined
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, SensorMemory
from ndob_fmu.runtime.step.fixed_lag import empty_lag, kept
from ndob_fmu.runtime.step.jump_bank import FIRST_RATE, columns_of, empty_bank


def start_memory(model: FilterModel) -> FilterMemory:
    """Return the memory before the first sample."""
    return FilterMemory(
        columns=start_columns(model),
        past=np.zeros(model.past_size),
        past_age=np.full(model.past_size // max(len(model.delayed), 1), -1.0),
        jumps=empty_bank(model.bound, FIRST_RATE),
        sensors=(SensorMemory(),) * len(model.equations.outputs),
        lagged=empty_lag(model.layout.q, model.settings.lag, columns_of(model.layout.q)),
        age=0,
        lost=False,
        converged=False,
        frozen_noise=(1.0,) * len(model.equations.outputs),
        tuned_at=0.0,
        step=0.0,
        steady=0,
        model_error=0.0,
    )


def start_columns(model: FilterModel) -> ErrorColumns:
    """Return the columns before the first sample."""
    q = model.layout.q
    past = np.zeros((model.rows, kept(model.settings.lag) * q))
    return joined(start_factor(model), np.zeros((model.rows, columns_of(q))), past)


def start_factor(model: FilterModel) -> Array:
    """Return the factor (N + past,N + past) of the covariance before the first sample."""
    factor = np.zeros((model.rows, model.rows))
    factor[: model.layout.size, : model.layout.size] = np.diag(model.start_std)
    return factor
