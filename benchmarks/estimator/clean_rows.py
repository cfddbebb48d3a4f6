"""Rows of good samples: the error beside the extended Kalman filter, settling, error bars and `valid`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.estimator.figures import Figure
from benchmarks.estimator.kalman import ekf
from benchmarks.estimator.ours import ours_of, published_intensity
from benchmarks.estimator.plants import ARM, CYLINDER, JOINT, MOTOR, Plant
from benchmarks.estimator.records import jump, simulate
from benchmarks.estimator.scores import score, settling_time
from benchmarks.estimator.tasks import Seeds, Task, ms, plant_of

ORDERS = (0, 1, 2, 3)
# Plant, H, what the first version reached, and a limit besides that of the Kalman filter.
_CELLS: tuple[tuple[Plant, float, str, float | None], ...] = (
    (CYLINDER, 1e-3, ".0077", None),
    (CYLINDER, 5e-3, ".0095", None),
    (CYLINDER, 1e-2, ".0218", None),
    (CYLINDER, 2e-2, ".0417", None),
    (MOTOR, 5e-3, ".0021", None),
    (MOTOR, 1e-2, ".0020", None),
    (MOTOR, 2e-2, ".0102", 0.0016),
    (JOINT, 5e-3, ".0454", 0.046),
    (JOINT, 2e-2, ".0518", None),
)
_COVERED: tuple[tuple[Plant, tuple[float, ...]], ...] = (
    (JOINT, (1e-3, 5e-3, 1e-2, 2e-2)),
    (CYLINDER, (1e-3, 5e-3, 1e-2, 2e-2)),
    (MOTOR, (1e-3, 5e-3, 1e-2, 2e-2)),
    (ARM, (1e-3, 5e-3, 1e-2)),
)
_COVERAGE = ", good samples: share within 2·std"
_BAND = 0.1  # of the step in d, within which the error has settled


def tasks() -> list[Task]:
    """Return the tasks of this module."""
    return [
        *(Task(f"clean {plant.name} {ms(H)}", accuracy, (plant.name, H, *more)) for plant, H, *more in _CELLS),
        *(Task(f"settling motor {ms(H)}", settling, (H, once)) for H, once in ((1e-2, ".12 s"), (2e-2, ".24 s"))),
        *(
            Task(f"coverage {plant.name} {ms(H)}", coverage, (plant.name, H))
            for plant, steps in _COVERED
            for H in steps
        ),
    ]


def accuracy(seeds: Seeds, name: str, H: float, once: str, limit: float | None) -> list[Figure]:
    """Judge the error at the sample."""
    plant = plant_of(name)
    record = simulate(plant, H, seeds)
    found = score(record, ours_of(record)).rms
    text = f"{name}, sine, {ms(H)}"
    figures = [] if limit is None else [Figure(text, limit, found, once)]
    for kind, intensity in (("the same intensity", published_intensity(plant, H)), ("its best intensity", None)):
        of_filter = score(record, ekf(record, intensity=intensity)).rms
        figures.append(Figure(f"{text}: 1.1 × EKF with {kind}", 1.1 * of_filter, found, once))
    return figures


def settling(seeds: Seeds, H: float, once: str) -> list[Figure]:
    """Judge the motor after a step of D₀/2: the time until the error stays within a tenth of it."""
    at = 0.5
    record = simulate(MOTOR, H, seeds, jump(MOTOR, 0.0, 0.5, at), stop_time=1.5)
    found = ours_of(record)
    text = f"motor, {ms(H)}, step of D₀/2"
    settled = settling_time(record, found["at"], at, 0.5 * _BAND)
    used = float(np.mean(found["valid"]))
    return [
        Figure(f"{text}: until the error stays within a tenth, s", 0.04, settled, once),
        # The first sample after the step cannot be told from an outlier.
        Figure(f"{text}: share of the samples with `valid` true", 0.98, used, at_least=True),
    ]


def coverage(seeds: Seeds, name: str, H: float) -> list[Figure]:
    """Judge the error bars and `valid` for each disturbance order."""
    record = simulate(plant_of(name), H, seeds)
    figures = []
    for order in ORDERS:
        found = score(record, ours_of(record, disturbance_order=order))
        text = f"{name}, {ms(H)}, r = {order}"
        figures += [
            Figure(f"{text}{_COVERAGE}", 0.90, found.covered, at_least=True),
            Figure(f"{text}: largest std, D₀", 1.0, found.largest_std),
            Figure(f"{text}: share with `valid` true", 1.0, found.valid, at_least=True),
        ]
    return figures


def together(figures: Sequence[Figure]) -> list[Figure]:
    """Return the mean coverage of all cells that `coverage` has judged; empty if there are none.

    Only the mean has an upper limit: where a long step makes most of the error a bias, all of a cell lies inside.
    """
    shares = [f.measured for f in figures if f.text.endswith(_COVERAGE) and f.measured is not None]
    if not shares:
        return []
    mean, text = float(np.mean(shares)), f"mean of {len(shares)} cells{_COVERAGE}"
    return [Figure(text, 0.90, mean, at_least=True), Figure(text, 0.99, mean)]
