"""What the next sample should be: the row of each output, its innovation, and the variance of both parts of that."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.step.delayed_outputs import row_in_past
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, SampledObserverState

# A number further from its prediction than so many standard deviations counts as not finite: its square may be.
_FARTHEST = 1e100


@dataclass(frozen=True)
class Prediction:
    """A sample beside its prediction, (p,) each.

    rows: (N + past,) of each output; None where its sensor measured a time before the start
    measured: whether an output was measured and can be predicted
    innovation: y − ŷ, 0 where nothing was measured
    noise: variance of the noise in a sample
    std: standard deviation of the innovation
    """

    rows: list[Array | None]
    measured: list[bool]
    innovation: list[float]
    noise: list[float]
    std: list[float]


def predicted(model: FilterModel, xi: Array, memory: FilterMemory, u: Vector, y: Vector) -> Prediction:
    """Return the prediction of a sample y (p,) at ξ̂⁻ (N + past,) and u (m,)."""
    rows = output_rows(model, xi, memory, u)
    expected = _expected(model, xi, u, rows)
    noise = model.noise_used(memory.sensors)
    std = [sqrt(spread(row, memory.columns.factor) + R) for row, R in zip(rows, noise, strict=True)]
    measured = [
        row is not None and isfinite(y[i]) and abs(y[i] - expected[i]) <= _FARTHEST * std[i]
        for i, row in enumerate(rows)
    ]
    return Prediction(
        rows=rows,
        measured=measured,
        innovation=[y[i] - expected[i] if one else 0.0 for i, one in enumerate(measured)],
        noise=noise,
        std=std,
    )


def predicted_before_a_step(model: FilterModel, state: SampledObserverState, y: Vector) -> Prediction:
    """Return the prediction of a sample y (p,) from all that the observer remembers."""
    xi = np.concatenate([model.layout.unpacked(state.xi_hat), state.memory.past])
    return predicted(model, xi, state.memory, state.u, y)


def spread(row: Array | None, factor: Array) -> float:
    """Return the variance of what a row (rows,) measures, for a factor (rows,·); 0 without a row."""
    if row is None:
        return 0.0
    seen = row @ factor
    return float(seen @ seen)


def output_rows(model: FilterModel, xi: Array, memory: FilterMemory, u: Vector) -> list[Array | None]:
    """Return the row (N + past,) of each output; None where its sensor measured a time before the start."""
    C = model.output_slopes(xi, u)
    if not model.delayed:
        return list(C)
    rows: list[Array | None] = []
    for i, tau in enumerate(model.settings.sensors.delay):
        now = np.zeros(model.rows)
        now[: model.layout.size] = C[i]
        if tau > 0.0:
            which = model.delayed.index(i)
            rows.append(row_in_past(memory.past_age, tau, now, which, len(model.delayed)))
        else:
            rows.append(now)
    return rows


def _expected(model: FilterModel, xi: Array, u: Vector, rows: list[Array | None]) -> list[float]:
    expected = model.predicted_output(xi, u)
    for i in model.delayed:
        row = rows[i]
        if row is not None:
            # The last node of the interpolation is the output at this sample, as far as the row has entries there.
            share = 1.0 - float(np.sum(row[model.layout.size :]))
            expected[i] = share * expected[i] + float(row[model.layout.size :] @ xi[model.layout.size :])
    return expected
