"""What the sampled-data observer remembers before the first sample."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, SensorMemory
from ndob_fmu.runtime.step.fixed_lag import empty_lag
from ndob_fmu.runtime.step.jump_bank import empty_bank


def start_memory(model: FilterModel) -> FilterMemory:
    """Return the memory before the first sample."""
    p, rows = len(model.equations.outputs), model.rows
    zeros = np.zeros(p)
    return FilterMemory(
        factor=start_factor(model),
        past=np.zeros(model.past_size),
        past_age=np.full(model.past_size // max(len(model.delayed), 1), -1.0),
        jumps=empty_bank(rows, model.layout.q),
        sensors=SensorMemory(
            noise_ratio=np.ones(p),
            counted=zeros,
            repeat_rate=zeros,
            resolution=np.full(p, np.inf),
            alike=zeros,
            refused=np.zeros(p, dtype=bool),
            debt=zeros,
            skipped=zeros,
            drift=zeros,
            mean=zeros,
            waited=zeros,
            interval=zeros,
        ),
        lagged=empty_lag(rows, model.layout.q, model.settings.lag),
        age=0,
        lost=False,
        converged=False,
        tuned_at=0.0,
        step=0.0,
        steady=0,
    )


def start_factor(model: FilterModel) -> Array:
    """Return the factor (N + past,N + past) of the covariance before the first sample."""
    factor = np.zeros((model.rows, model.rows))
    factor[: model.layout.size, : model.layout.size] = np.diag(model.start_std)
    return factor
