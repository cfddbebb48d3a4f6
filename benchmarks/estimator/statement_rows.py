"""Rows of statements that are wrong or half true: noise told wrongly, samples rounded, parameters known roughly."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.estimator import faults
from benchmarks.estimator.figures import Figure
from benchmarks.estimator.kalman import ekf, tuned_intensity
from benchmarks.estimator.ours import ours_of, published_intensity
from benchmarks.estimator.plants import CYLINDER, JOINT, MOTOR, Plant
from benchmarks.estimator.records import Record, simulate
from benchmarks.estimator.scores import score
from benchmarks.estimator.tasks import Seeds, Task, ms, plant_of

H = 5e-3
DRAWS = 4  # of the true parameters, for each seed
UNCERTAINTY = 0.1  # of each parameter, one standard deviation
EXACT_SIGMA = 1e-6  # of all outputs where parameters are uncertain

_NOISES: tuple[tuple[str, float, Callable[[Record], Record] | None, str, float], ...] = (
    ("noise told 1/10", 0.1, None, ".27", 0.042),
    ("noise told 1/100", 0.01, None, "1.11", 0.045),
    ("noise told 10 ×", 10.0, None, ".049", 0.046),
    ("quantised to 20 σ", 1.0, faults.quantised, ".27", 0.10),
)
_MIXED = ((1e-4, 1e-6, ".0098"), (1e-6, 1e-2, ".0021"))


def tasks() -> list[Task]:
    """Return the tasks of this module."""
    return [
        *(Task(f"told {text}", noise_told, (index,)) for index, (text, *_) in enumerate(_NOISES)),
        *(
            Task(
                f"parameters {plant.name} {'estimated' if estimated else 'considered'}", uncertain, (plant.name, *more)
            )
            for plant, *more in (
                (JOINT, False, "43 %", 0.0),
                (CYLINDER, False, "97 %", 0.0),
                (JOINT, True, ".047", 0.026),
                (CYLINDER, True, ".0166", 0.003),
            )
            for estimated in more[:1]
        ),
        Task("parameters motor untold", untold, ()),
        *(Task(f"mixed σ {first:g} {second:g}", mixed, (first, second, once)) for first, second, once in _MIXED),
    ]


def told_noise(plant: Plant, sigma: Any) -> dict[str, float]:
    """Return the FMU's parameters for standard deviations (p,)."""
    return {f"{y}_noise_std": float(s) for y, s in zip(plant.model().outputs, sigma, strict=True)}


def noise_told(seeds: Seeds, index: int) -> list[Figure]:
    """Judge the joint with noise that is told wrongly, or with samples that are rounded."""
    text, factor, fault, once, limit = _NOISES[index]
    record = simulate(JOINT, H, seeds, stop_time=4.0)
    if fault:
        record = fault(record)
    found = score(record, ours_of(record, **told_noise(JOINT, factor * JOINT.sigma)), begin=0.4)
    text = f"joint, {ms(H)}, {text}"
    return [
        Figure(text, limit, found.rms, once),
        Figure(f"{text}: share within 2·std", 0.90, found.covered, at_least=True),
    ]


def uncertain(seeds: Seeds, name: str, estimated: bool, once: str, limit: float) -> list[Figure]:
    """Judge plants whose parameters differ from the told ones by a tenth, one standard deviation."""
    plant = plant_of(name)
    record = drawn(plant, seeds)
    told = told_noise(plant, np.full(len(plant.C), EXACT_SIGMA))
    std = {f"{key}_std": UNCERTAINTY * abs(value) for key, value in plant.parameters.items()}
    text = f"{name}, {ms(H)}, σ = 1e-6, parameters ± 10 %"
    if estimated:
        found = score(record, ours_of(record, **told, **std, estimate_parameters=True))
        return [
            Figure(f"{text}, estimated", limit, found.rms, once),
            Figure(f"{text}, estimated: share within 2·std", 0.90, found.covered, at_least=True),
        ]
    without = score(record, ours_of(record, **told)).rms
    found = score(record, ours_of(record, **told, **std))
    return [
        Figure(f"{text}, told: share within 2·std", 0.90, found.covered, once, at_least=True),
        Figure(f"{text}, told: the error without that", without, found.rms),
    ]


def untold(seeds: Seeds) -> list[Figure]:
    """Judge the motor, whose outputs contradict each other where its parameters are wrong, if no one says that."""
    record = drawn(MOTOR, seeds)
    found = score(record, ours_of(record, **told_noise(MOTOR, np.full(len(MOTOR.C), EXACT_SIGMA))))
    return [Figure(f"motor, {ms(H)}, σ = 1e-6, parameters ± 10 %, not told", 0.5, found.rms, "refused")]


def drawn(plant: Plant, seeds: Seeds) -> Record:
    """Return records of plants whose parameters are drawn around the told ones."""
    wide = tuple(100 * seed + i for seed in seeds for i in range(DRAWS))
    factors = np.stack(
        [1.0 + UNCERTAINTY * np.random.default_rng([s, 5]).standard_normal(len(plant.parameters)) for s in wide]
    )
    true = {key: value * factors[:, i] for i, (key, value) in enumerate(plant.parameters.items())}
    stop_time = 0.8 * plant.stop_time
    return simulate(plant, H, wide, sigma=np.full(len(plant.C), EXACT_SIGMA), parameters=true, stop_time=stop_time)


def mixed(seeds: Seeds, first: float, second: float, once: str) -> list[Figure]:
    """Judge the cylinder with a noise of its own on each output."""
    sigma = np.array([first, second])
    record = simulate(CYLINDER, H, seeds, sigma=sigma)
    told = told_noise(CYLINDER, sigma)
    found = score(record, ours_of(record, **told))
    text = f"cylinder, {ms(H)}, σ = {first:g} m and {second:g} MPa"
    figures = []
    for kind, intensity in (
        ("the same intensity", published_intensity(CYLINDER, H, **told)),
        ("its best intensity", tuned_intensity(CYLINDER, H, 2, tuple(sigma.tolist()))),
    ):
        limit = 1.1 * score(record, ekf(record, sigma=sigma, intensity=intensity)).rms
        figures.append(Figure(f"{text}: 1.1 × EKF with {kind}", limit, found.rms, once))
    return [
        *figures,
        Figure(f"{text}: share within 2·std", 0.90, found.covered, at_least=True),
    ]
