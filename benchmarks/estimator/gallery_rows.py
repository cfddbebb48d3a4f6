"""Rows of the gallery's plants: the error beside the extended Kalman filter with the same information, error bars."""

from __future__ import annotations

from benchmarks.estimator.figures import Figure
from benchmarks.estimator.kalman import ekf
from benchmarks.estimator.ours import ours_of
from benchmarks.estimator.plants import Plant
from benchmarks.estimator.records import simulate
from benchmarks.estimator.scores import score
from benchmarks.estimator.tasks import Seeds, Task, ms
from benchmarks.gallery.plants import gallery_plants

_LIMIT = 1.15  # times the error of the filter


def tasks() -> list[Task]:
    """Return the tasks of this module."""
    return [Task(f"gallery {plant.name}", beside_the_filter, (plant.name,)) for plant in gallery_plants()]


def step_of(plant: Plant) -> float:
    """Return the step (s) of the plant's default experiment."""
    return float(plant.model().experiment.step_size)


def beside_the_filter(seeds: Seeds, name: str) -> list[Figure]:
    """Judge the error at the sample, the error bars and `valid`."""
    plant = next(plant for plant in gallery_plants() if plant.name == name)
    H = step_of(plant)
    record = simulate(plant, H, seeds)
    found, of_filter = score(record, ours_of(record)), score(record, ekf(record))
    text = f"{name}, sine, {ms(H)}"
    return [
        Figure(f"{text}: {_LIMIT} × EKF with its best intensity", _LIMIT * of_filter.rms, found.rms),
        Figure(f"{text}, good samples: share within 2·std", 0.90, found.covered, at_least=True),
        Figure(f"{text}: share with `valid` true", 1.0, found.valid, at_least=True),
    ]
