"""Records of a plant, for several seeds at once: the truth by Runge–Kutta of order 4, and the samples with noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, pi
from typing import Any

import numpy as np

from benchmarks.estimator.plants import Array, Plant, Slope

Disturbance = Callable[[float], Any]  # one number or (q,)
# Of a substep: a disturbance that jumps at its end has not done so yet. More than what rounding makes of the time.
_BEFORE = 1.0 - 1e-6


@dataclass(frozen=True)
class Record:
    """B records of a plant at the times t (K,), with the steps (K,) that follow them, in s.

    U (B,K,m): the input held over each step
    Y (B,K,p): the samples; NaN where there is none
    d, d_end (K,q): the disturbances at t and at the end of the step
    disturbance: d(t)
    """

    plant: Plant
    seeds: tuple[int, ...]
    t: Array
    steps: Array
    U: Array
    Y: Array
    d: Array
    d_end: Array
    disturbance: Disturbance

    @property
    def H(self) -> float:
        """The step (s) where all are equal, else the mean."""
        return float(np.mean(self.steps))

    def with_samples(self, Y: Array) -> Record:
        """Return the same record with other samples."""
        return replace(self, Y=Y)


def sine(plant: Plant, amplitude: float = 0.5) -> Disturbance:
    """Return sines about the nominal values at the plant's pace, with an amplitude in D₀ and a radian between them."""
    behind = np.arange(len(plant.bounds))
    return lambda t: plant.nominal + amplitude * plant.bounds * np.sin(2.0 * pi * plant.pace * t - behind)


def jump(plant: Plant, begin: float, end: float, at: float) -> Disturbance:
    """Return a disturbance that jumps from `begin` to `end` (D₀) at the time `at` (s)."""
    return lambda t: plant.bound * (end if t >= at - 1e-12 else begin)


def simulate(
    plant: Plant,
    steps: float | Array,
    seeds: Sequence[int],
    disturbance: Disturbance | None = None,
    *,
    stop_time: float | None = None,
    sigma: Array | None = None,
    parameters: Mapping[str, Any] | None = None,
    delays: Sequence[float] | None = None,
) -> Record:
    """Simulate the plant once for each seed of the noise.

    steps: H (s), or one step after the other (K,)
    disturbance: d(t), by default a sine of D₀/2
    sigma: (p,), by default the plant's
    parameters: the plant's true ones where they differ, numbers or one for each seed
    delays: (p,) in s, of each sample behind its time; without a sample from before t = 0 it is NaN. Multiples of a
    substep. The controller reads samples without delay.
    """
    disturbance = disturbance or sine(plant)
    stop_time = plant.stop_time if stop_time is None else stop_time
    if isinstance(steps, float):
        steps = np.full(round(stop_time / steps), steps)
    count, batch, (p, n) = len(steps), len(seeds), plant.C.shape
    substeps = max(2, ceil(float(np.max(steps)) / plant.substep - 1e-9))
    substeps += substeps % 2
    values = {**plant.parameters, **(parameters or {})}
    noise = np.stack([np.random.default_rng([seed, 1]).standard_normal((count, p)) for seed in seeds])
    noise *= plant.sigma if sigma is None else sigma
    t = np.concatenate([[0.0], np.cumsum(steps)])
    x = np.tile(plant.x0, (batch, 1))
    path = np.empty((batch, count * substeps + 1, n))
    inputs = []
    memory: dict[str, Array] = {}
    for k in range(count):
        path[:, k * substeps] = x
        u = plant.control(float(t[k]), plant.sampled(x @ plant.C.T, noise[:, k]), memory, float(steps[k]))
        inputs.append(u)
        h = float(steps[k]) / substeps
        for i in range(substeps):
            x = _runge_kutta_step(plant.slope, x, u, disturbance, float(t[k]) + i * h, h, values)
            path[:, k * substeps + i + 1] = x
    if not np.all(np.isfinite(path)):
        raise ValueError(f"{plant.name}: expected a bounded motion, received one that diverges")
    outputs = np.empty((batch, count, p))
    missing = np.zeros((count, p), dtype=bool)
    for i, delay in enumerate(delays or [0.0] * p):
        behind = round(delay / (float(steps[0]) / substeps))
        at = np.arange(count) * substeps - behind
        outputs[:, :, i] = path[:, np.maximum(at, 0)] @ plant.C[i]
        missing[:, i] = at < 0
    samples = np.where(missing, np.nan, plant.sampled(outputs, noise))
    d = np.array([np.atleast_1d(disturbance(float(time))) for time in t])
    return Record(plant, tuple(seeds), t[:-1], steps, np.stack(inputs, axis=1), samples, d[:-1], d[1:], disturbance)


def _runge_kutta_step(
    slope: Slope, x: Array, u: Array, disturbance: Disturbance, t: float, h: float, values: Mapping[str, Any]
) -> Array:
    first, middle, last = (np.atleast_1d(disturbance(t + share * h)) for share in (0.0, 0.5, _BEFORE))
    k1 = slope(x, u, first, values)
    k2 = slope(x + 0.5 * h * k1, u, middle, values)
    k3 = slope(x + 0.5 * h * k2, u, middle, values)
    k4 = slope(x + h * k3, u, last, values)
    return np.asarray(x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))
