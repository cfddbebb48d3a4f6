"""What is wrong where too many samples were refused, or where all are on one side of their predictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, SampledObserverState, SensorMemory
from ndob_fmu.runtime.step.jump_bank import empty_bank
from ndob_fmu.runtime.step.measurement_update import Measured, measure, output_rows
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


def is_hopeless(sensors: SensorMemory) -> bool:
    """Return whether so many samples were refused, or all on one side, that what the observer knows must be wrong."""
    return bool(np.any(_refuted(sensors) | (np.abs(sensors.mean) > _WRONG)))


def _refuted(sensors: SensorMemory) -> NDArray[np.bool_]:
    """Return for which outputs (p,) too many samples were refused.

    While other samples agree with the estimate, refused ones of one sign are more likely wrong themselves.
    """
    agreed = np.array(
        [len(sensors.refused) > 1 and not np.all(np.delete(sensors.refused, i)) for i in range(len(sensors.refused))]
    )
    limit = np.where(_of_one_sign(sensors), np.where(agreed, _PATIENCE * _HOPELESS, _HOPELESS), _NOISY)
    return np.asarray(sensors.debt > limit)


def _of_one_sign(sensors: SensorMemory) -> NDArray[np.bool_]:
    return np.asarray(sensors.drift**2 > _ONE_SIGN * sensors.skipped)


def reconsidered(model: FilterModel, xi: Array, memory: FilterMemory, sensors: SensorMemory, u: Vector) -> FilterMemory:
    """Return the memory before a sample, once so many samples were refused that what it says must be wrong.

    Refused innovations of both signs mean that the noise is larger than was told, those of one sign that the estimate
    is worse than its covariance says. Either is enlarged until these innovations are twice their standard deviation.
    """
    biased = np.abs(sensors.mean) > _WRONG
    refused = _refuted(sensors)
    hopeless = refused | biased
    one_sign = biased | _of_one_sign(sensors)
    ratios = np.array(model.noise_ratios(sensors.noise_ratio))
    noise = model.noise_variance * ratios
    larger = hopeless & ~one_sign if model.adapts else np.zeros(len(noise), dtype=bool)
    ratio = np.where(
        larger, np.maximum(sensors.noise_ratio, 0.25 * sensors.skipped / model.noise_variance), sensors.noise_ratio
    )
    grown = float(np.max(np.where(larger, ratio / ratios, 1.0)))
    growth = min(grown, _LEAST_GROWTH)
    rows = output_rows(model, xi, memory, u)
    for i in np.flatnonzero(hopeless & ~larger):
        row = rows[i]
        spread = 0.0 if row is None else float(np.sum((row @ memory.factor) ** 2))
        if spread > 0.0:
            square = sensors.skipped[i] if refused[i] else sensors.mean[i] ** 2 * (spread + noise[i])
            growth = max(growth, float(0.25 * square - noise[i]) / spread, _LEAST_GROWTH)
    growth = float(np.sqrt(growth))
    return replace(
        memory,
        factor=start_factor(model) if growth > _LOST else memory.factor * growth,
        sensors=replace(
            memory.sensors,
            noise_ratio=ratio,
            counted=np.where(larger, 0.0, sensors.counted),
            debt=np.zeros_like(ratio),
            refused=np.zeros(len(ratio), dtype=bool),
            mean=np.zeros_like(ratio),
        ),
        jumps=empty_bank(model.rows, model.layout.q),
        lost=memory.lost or (max(growth, grown) > _LOST and memory.age >= model.start_samples),
        age=min(memory.age, 2 * model.layout.size) if max(growth, grown) > _LOST else memory.age,
    )
