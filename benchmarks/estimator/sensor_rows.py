"""Rows of slow and late sensors, of steps that vary, of the lagged estimate, and of a stiff plant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.estimator import faults
from benchmarks.estimator.figures import Figure
from benchmarks.estimator.kalman import ekf, out_of_sequence
from benchmarks.estimator.ours import NotAvailableError, ours_of, plant_run, published_intensity
from benchmarks.estimator.plants import CYLINDER, JOINT, LAG, MOTOR, UNLAGGED, Plant
from benchmarks.estimator.records import simulate
from benchmarks.estimator.scores import STEADY_FROM, rms, score
from benchmarks.estimator.tasks import Seeds, Task, ms, plant_of

H = 5e-3
_LIMIT_OF_LAG = {25e-3: 0.022, 50e-3: 0.010}


def tasks() -> list[Task]:
    """Return the tasks of this module."""
    return [
        *(Task(f"slow sensor {plant.name}", slow_sensor, (plant.name,)) for plant in (JOINT, CYLINDER)),
        Task("slow sensor linear", slow_sensor_on_a_linear_plant),
        *(
            Task(f"delay {plant.name} {samples:g}", delayed, (plant.name, samples))
            for plant in (JOINT, CYLINDER)
            for samples in (0.5, 1.0, 10.0)
        ),
        *(Task(f"delay {plant.name} of one output", one_delayed, (plant.name,)) for plant in (JOINT, CYLINDER)),
        *(Task(f"jitter {plant.name}", jitter, (plant.name,)) for plant in (JOINT, CYLINDER, MOTOR)),
        *(Task(f"lag {ms(lag)}", lagged, (lag,)) for lag in _LIMIT_OF_LAG),
        Task("stiff", stiff),
    ]


_FINER = 64


def slow_sensor(seeds: Seeds, name: str) -> list[Figure]:
    """Judge a second output that is measured in every tenth sample only."""
    plant = plant_of(name)
    record = faults.every_tenth(simulate(plant, H, seeds), 1)
    found = score(record, ours_of(record))
    text = f"{name}, {ms(H)}, second sensor at a tenth of the rate"
    best = score(record, ekf(record, intensity=published_intensity(plant, H))).rms
    return [
        Figure(f"{text}: 1.05 × EKF with the same intensity", 1.05 * best, found.rms),
        Figure(f"{text}: share with `valid` true", 0.99, found.valid, "10 %", at_least=True),
    ]


def slow_sensor_on_a_linear_plant(seeds: Seeds) -> list[Figure]:
    """Compare with the time-varying Kalman filter on the joint without gravity: both are the optimum."""
    linear = {"gravity_torque": 0.0}
    record = faults.every_tenth(simulate(JOINT, H, seeds, parameters=linear), 1)
    found = ours_of(record, **linear, adapt_noise=False)
    # The filter's own integration is exact to 1e-6 only with the usual substeps.
    exact = replace(record, plant=replace(JOINT, substep=JOINT.substep / _FINER))
    best = ekf(exact, parameters=linear, intensity=published_intensity(JOINT, H, **linear))
    begin = int(STEADY_FROM * len(record.t))
    difference = float(np.max(np.abs(found["at"] - best["at"])[:, begin:])) / JOINT.bound
    return [Figure(f"joint without gravity, {ms(H)}, the same: difference to the optimum", 1e-9, difference)]


def delayed(seeds: Seeds, name: str, samples: float) -> list[Figure]:
    """Judge samples that are late by a known delay, beside a filter that lives at their times."""
    plant = plant_of(name)
    delay = samples * H
    record = simulate(plant, H, seeds, delays=[delay] * len(plant.C))
    told = {f"{y}_delay": delay for y in plant.model().outputs}
    found = score(record, ours_of(record, **told))
    best = score(record, ekf(record, delay=delay, intensity=published_intensity(plant, H))).rms
    text = f"{name}, {ms(H)}, samples {samples:g} steps late"
    return [
        Figure(f"{text}: 1.1 × EKF at their times", 1.1 * best, found.rms),
        Figure(f"{text}: share within 2·std", 0.90, found.covered, at_least=True),
    ]


def one_delayed(seeds: Seeds, name: str, late: int = 10) -> list[Figure]:
    """Judge a second output that is late, while the first is not."""
    plant = plant_of(name)
    record = simulate(plant, H, seeds, delays=[0.0, late * H])
    found = score(record, ours_of(record, **{f"{plant.model().outputs[1]}_delay": late * H}))
    best = out_of_sequence(record, [0, late], intensity=published_intensity(plant, H))
    text = f"{name}, {ms(H)}, second output {late} steps late"
    return [Figure(f"{text}: 1.1 × EKF that goes over them again", 1.1 * score(record, {"at": best}).rms, found.rms)]


def jitter(seeds: Seeds, name: str) -> list[Figure]:
    """Judge steps that differ by up to 30 %, as told by the host."""
    plant = plant_of(name)
    fixed = simulate(plant, H, seeds)
    limit = 1.1 * score(fixed, ours_of(fixed)).rms
    record = simulate(plant, faults.jittering(H, plant.stop_time, seeds[0]), seeds)
    found = score(record, ours_of(record))
    text = f"{name}, {ms(H)} ± 30 %"
    return [
        Figure(f"{text}: 1.1 × the error at a fixed step", limit, found.rms),
        Figure(f"{text}: share with `valid` true", 1.0, found.valid, at_least=True),
    ]


def lagged(seeds: Seeds, lag: float) -> list[Figure]:
    """Judge the joint's estimate for `lag` before the sample."""
    record = simulate(JOINT, H, seeds)
    found = ours_of(record, lag=lag)
    if "lagged" not in found:
        raise NotAvailableError("an output for `lag` before the sample")
    d = np.array([np.atleast_1d(record.disturbance(t - lag)) for t in record.t])
    begin = int(STEADY_FROM * len(record.t))
    error = np.abs(found["lagged"] - d)[:, begin:]
    covered = float(np.mean(error <= 2.0 * found["lagged_std"][:, begin:]))
    text = f"joint, {ms(H)}, {ms(lag)} before the sample"
    return [
        Figure(text, _LIMIT_OF_LAG[lag], rms(error / JOINT.bound)),
        Figure(f"{text}: share within 2·std", 0.90, covered, at_least=True),
    ]


def stiff(seeds: Seeds) -> list[Figure]:
    """Judge a plant with a time constant of 1e-6 s at H = 10 ms, and the observer of it."""
    step, count = 1e-2, 100
    inputs = np.sin(2.0 * np.pi * step * np.arange(count))[:, None]
    path, of_plant = plant_run(LAG, step, inputs)
    x, exact = LAG.x0, []
    for k in range(count):
        x = _radau(LAG, x, inputs[k], step)
        exact.append(x)
    difference = np.max(np.abs(path - exact) / np.max(np.abs(exact), axis=0))
    record = replace(simulate(UNLAGGED, step, seeds, stop_time=count * step), plant=LAG)
    estimates = ours_of(record)
    found, of_observer = score(record, estimates), float(np.median(estimates["seconds"]))
    text = "time constant 1e-6 s, 10 ms"
    return [
        Figure(f"{text}: plant, difference to Radau over the range", 1e-6, float(difference), "never ends"),
        Figure(f"{text}: plant, median s a step", 5e-3, float(np.median(of_plant)), "never ends", timed=True),
        Figure(f"{text}: observer, RMS", 0.05, found.rms, "never ends"),
        Figure(f"{text}: observer, median s a step", 5e-3, of_observer, "never ends", timed=True),
    ]


def _radau(plant: Plant, x: Any, u: Any, step: float) -> Any:
    still = np.zeros(1)
    solved = solve_ivp(
        lambda t, x: plant.slope(x, u, still, plant.parameters), (0.0, step), x, method="Radau", rtol=1e-11, atol=1e-13
    )
    return solved.y[:, -1]
