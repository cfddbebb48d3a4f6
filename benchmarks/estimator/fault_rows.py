"""Rows of faulty samples and of disturbances that jump."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.estimator import faults
from benchmarks.estimator.figures import Figure
from benchmarks.estimator.kalman import ekf
from benchmarks.estimator.ours import Estimates, ours_of
from benchmarks.estimator.plants import CYLINDER, JOINT, Plant
from benchmarks.estimator.records import Record, jump, simulate
from benchmarks.estimator.scores import STEADY_FROM, score
from benchmarks.estimator.tasks import Seeds, Task, ms, plant_of

H = 5e-3
FAULTS: dict[str, Callable[[Record], Record]] = {
    "2 % outliers of 50 σ": lambda record: faults.outliers(record, 50.0),
    "2 % outliers of 5000 σ": lambda record: faults.outliers(record, 5000.0),
    "5 % repeated": faults.repeated,
    "12 stuck": faults.stuck,
    "jump of 2 D₀": lambda record: record,
    "jump and outliers": lambda record: faults.outliers(record, 50.0),
}
# Plant, fault, what the first version reached, the limits of RMS and peak.
_ROWS: tuple[tuple[Plant, str, str, float, float | None], ...] = (
    (JOINT, "2 % outliers of 50 σ", ".53", 0.050, 0.6),
    (JOINT, "2 % outliers of 5000 σ", "29", 0.050, 0.6),
    (JOINT, "5 % repeated", ".84", 0.050, 0.6),
    (JOINT, "12 stuck", "9.5", 0.050, 0.6),
    (JOINT, "jump of 2 D₀", ".265", 0.18, None),
    (JOINT, "jump and outliers", ".60", 0.18, None),
    (CYLINDER, "5 % repeated", ".011", 0.006, None),
    (CYLINDER, "12 stuck", ".019", 0.010, None),
    (CYLINDER, "jump of 2 D₀", ".249", 0.13, None),
)
# No figure is required of these; a limit of ours keeps them from being worse than what is required elsewhere.
_UNSEEN, _CHANGES = 0.01, 4.0


def tasks() -> list[Task]:
    """Return the tasks of this module."""
    return [
        *(Task(f"fault {plant.name} {fault}", faulty, (plant.name, fault, *more)) for plant, fault, *more in _ROWS),
        *(Task(f"fault {plant.name} lost samples", lost_samples, (plant.name,)) for plant in (JOINT, CYLINDER)),
    ]


def faulty_record(plant: Plant, fault: str, seeds: Seeds, step: float = H) -> Record:
    """Return records with a fault of `FAULTS`; d jumps in the middle where the fault says so, else it is a sine."""
    jumps = jump(plant, -1.0, 1.0, 0.5 * plant.stop_time) if fault.startswith("jump") else None
    return FAULTS[fault](simulate(plant, step, seeds, jumps))


def faulty(seeds: Seeds, name: str, fault: str, once: str, limit: float, peak: float | None) -> list[Figure]:
    """Judge error and `valid` of records with a fault."""
    record = faulty_record(plant_of(name), fault, seeds)
    estimates = ours_of(record)
    found = score(record, estimates)
    text = f"{name}, {ms(H)}, {fault}"
    figures = [Figure(text, limit, found.rms, once)]
    if peak is not None:
        figures.append(Figure(f"{text}: peak", peak, found.peak))
    return [*figures, *honesty(record, estimates, text)]


def lost_samples(seeds: Seeds, name: str) -> list[Figure]:
    """Judge records in which a fifth of the samples is NaN."""
    record = faults.lost(simulate(plant_of(name), H, seeds), 0.2)
    estimates = ours_of(record)
    text = f"{name}, {ms(H)}, 20 % lost"
    limit = 1.1 * score(record, ekf(record)).rms
    found = score(record, estimates)
    return [
        Figure(f"{text}: 1.1 × EKF with its best intensity", limit, found.rms),
        Figure(f"{text}: share within 2·std", 0.90, found.covered, at_least=True),
    ]


def honesty(record: Record, estimates: Estimates, text: str) -> list[Figure]:
    """Judge `valid`: it is false where the error is beyond three error bars, and does not flap."""
    begin = int(STEADY_FROM * len(record.t))
    beyond = np.abs(estimates["ahead"] - record.d_end)[:, begin:, 0] > 3.0 * estimates["std"][:, begin:, 0]
    unseen = float(np.mean(beyond & estimates["valid"][:, begin:]))
    changes = score(record, estimates).toggles / float(record.t[-1] - record.t[begin])
    return [
        Figure(f"{text}: share beyond 3·std with `valid` true", _UNSEEN, unseen),
        Figure(f"{text}: changes of `valid` a second", _CHANGES, changes),
    ]
