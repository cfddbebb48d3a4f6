"""What is wrong where too many samples were refused, or where all are on one side of their predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.step.error_columns import joined
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, SampledObserverState, SensorMemory
from ndob_fmu.runtime.step.fixed_lag import without_signatures
from ndob_fmu.runtime.step.jump_bank import empty_bank
from ndob_fmu.runtime.step.measurement_update import Measured, measure
from ndob_fmu.runtime.step.prediction import output_rows, spread
from ndob_fmu.runtime.step.start_memory import start_factor

# After refused samples of this improbability, in nats, the estimate is wrong, not the samples: where all are on one
# side of their predictions; so many times more while other outputs agree with the estimate; where they are on both.
_HOPELESS, _PATIENCE, _NOISY = 40.0, 10.0, 130.0
# The square of a mean over the mean of the squares: 1 for equal numbers.
_ONE_SIGN = 0.5
# The mean of the latest innovations, over their standard deviation, at which the estimate is wrong.
_WRONG = 2.5
# The least factor on a variance. From the second one on, on a standard deviation, the estimate is lost.
_LEAST_GROWTH, _LOST = 4.0, 5.0


def measured_or_reconsidered(
    model: FilterModel, xi: Array, state: SampledObserverState, y: Vector
) -> tuple[Measured, FilterMemory]:
    """Return the update by a sample y (p,), and the memory before it, which is another where the samples refute it."""
    memory = state.memory
    measured = measure(model, xi, state, memory, y)
    if is_hopeless(measured.sensors):
        memory = reconsidered(model, xi, memory, measured.sensors, state.u)
        measured = measure(model, xi, state, memory, y)
    return measured, memory


def is_hopeless(sensors: Sequence[SensorMemory]) -> bool:
    """Return whether so many samples were refused, or all on one side, that what the observer knows must be wrong."""
    return any(abs(sensor.mean) > _WRONG or _is_refuted(sensors, i) for i, sensor in enumerate(sensors))


def _is_refuted(sensors: Sequence[SensorMemory], i: int) -> bool:
    """Return whether too many samples of an output were refused.

    While other samples agree with the estimate, refused ones of one sign are more likely wrong themselves.
    """
    sensor = sensors[i]
    if not _of_one_sign(sensor):
        return sensor.debt > _NOISY
    agreed = any(not other.refused for j, other in enumerate(sensors) if j != i)
    return sensor.debt > (_PATIENCE * _HOPELESS if agreed else _HOPELESS)


def _of_one_sign(sensor: SensorMemory) -> bool:
    return sensor.drift**2 > _ONE_SIGN * sensor.skipped


def reconsidered(
    model: FilterModel, xi: Array, memory: FilterMemory, sensors: Sequence[SensorMemory], u: Vector
) -> FilterMemory:
    """Return the memory before a sample, once so many samples were refused that what it says must be wrong.

    Refused innovations of both signs mean that the noise is larger than was told, those of one sign that the estimate
    is worse than its covariance says. Either is enlarged until these innovations are twice their standard deviation.
    """
    ratios, used = model.noise_ratios(sensors), model.noise_used(sensors)
    rows = output_rows(model, xi, memory, u)
    after, grown, growth = [], 1.0, 0.0
    for i, (sensor, before) in enumerate(zip(sensors, memory.sensors, strict=True)):
        biased, refuted = abs(sensor.mean) > _WRONG, _is_refuted(sensors, i)
        ratio, counted = sensor.noise_ratio, sensor.counted
        if model.adapts and refuted and not (biased or _of_one_sign(sensor)):
            ratio, counted = max(ratio, 0.25 * sensor.skipped / float(model.noise_variance[i])), 0.0
            grown = max(grown, ratio / ratios[i])
        elif biased or refuted:
            own = spread(rows[i], memory.columns.factor)
            if own > 0.0:
                # The mean is one of limited numbers. It says that P is too small, not how much.
                needed = (0.25 * sensor.skipped - used[i]) / own if refuted else 0.0
                growth = max(growth, needed, _LEAST_GROWTH)
        after.append(
            replace(before, noise_ratio=ratio, counted=counted, debt=0.0, doubtful=0.0, refused=False, mean=0.0)
        )
    growth = sqrt(max(growth, min(grown, _LEAST_GROWTH)))
    factor = start_factor(model) if growth > _LOST else memory.columns.factor * model.growths(growth)[:, None]
    columns = memory.columns
    return replace(
        memory,
        columns=joined(factor, np.zeros_like(columns.signatures), columns.covariance),
        sensors=tuple(after),
        jumps=empty_bank(model.bound, memory.jumps.rate),
        lagged=without_signatures(memory.lagged),
        lost=memory.lost or (max(growth, grown) > _LOST and memory.age >= model.start_samples),
        age=min(memory.age, 2 * model.layout.size) if max(growth, grown) > _LOST else memory.age,
    )
