"""The rows of the estimator's requirements, each a task of its own: the plant, the fault, what is told, the limit."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.estimator import faults
from benchmarks.estimator.figures import Figure
from benchmarks.estimator.kalman import ekf
from benchmarks.estimator.ours import NotAvailableError, RefusedError, ours_of
from benchmarks.estimator.plants import CYLINDER, JOINT, MOTOR, PLANTS, Plant
from benchmarks.estimator.records import Record, jump, simulate
from benchmarks.estimator.scores import score, settling_time

Seeds = tuple[int, ...]
Measure = Callable[[Seeds], list[Figure]]


@dataclass(frozen=True)
class Task:
    """Some rows that are measured together; `measure` takes the seeds of the records."""

    name: str
    function: Callable[..., list[Figure]]
    arguments: tuple[Any, ...] = ()


def run(task: Task, seeds: Seeds) -> list[Figure]:
    """Return the figures of a task; what the FMU does not have is one figure that says so."""
    try:
        return task.function(seeds, *task.arguments)
    except NotAvailableError as error:
        return [Figure(task.name, float("nan"), None, note=f"not available: {error}")]
    except RefusedError as error:
        return [Figure(task.name, float("nan"), None, note=f"refused: {error}")]


def tasks(pattern: str = "") -> list[Task]:
    """Return the tasks whose name contains the regular expression."""
    found = [
        *(Task(f"clean {plant.name} {_ms(H)}", clean, (plant.name, H, *limits)) for plant, H, *limits in _CLEAN),
        *(Task(f"settling motor {_ms(H)}", settling, (H, once)) for H, once in ((1e-2, ".12 s"), (2e-2, ".24 s"))),
        *(Task(f"fault {plant.name} {name}", faulty, (plant.name, name, *limits)) for plant, name, *limits in _FAULTY),
        *(
            Task(f"coverage {plant.name} {_ms(H)} r = {order}", coverage, (plant.name, H, order))
            for plant in PLANTS
            for H in _COVERED[plant.name]
            for order in (1, 2, 3)
        ),
    ]
    return [task for task in found if re.search(pattern, task.name)]


def plant_of(name: str) -> Plant:
    """Return the plant of that name."""
    return next(plant for plant in PLANTS if plant.name == name)


# -- clean records


# Plant, H, what the first version reached, and a limit, by default 1.1 times the EKF.
_CLEAN: tuple[tuple[Any, ...], ...] = (
    (CYLINDER, 1e-3, ".0077"),
    (CYLINDER, 5e-3, ".0095"),
    (CYLINDER, 1e-2, ".0218"),
    (CYLINDER, 2e-2, ".0417"),
    (MOTOR, 2e-2, ".0102", 0.0016),
    (JOINT, 5e-3, ".0454", 0.046),
)
_COVERED = {
    "joint": (1e-3, 5e-3, 1e-2, 2e-2),
    "cylinder": (1e-3, 5e-3, 1e-2, 2e-2),
    "motor": (1e-3, 5e-3, 1e-2, 2e-2),
    "arm": (1e-3, 5e-3, 1e-2),
}


def clean(seeds: Seeds, name: str, H: float, once: str, limit: float | None = None) -> list[Figure]:
    """Judge records without faults."""
    record = simulate(plant_of(name), H, seeds)
    text = f"{name}, sine, {_ms(H)}"
    if limit is None:
        limit = 1.1 * score(record, ekf(record)).rms
        text += ", 1.1 × EKF"
    return [Figure(text, limit, score(record, ours_of(record)).rms, once)]


def coverage(seeds: Seeds, name: str, H: float, order: int) -> list[Figure]:
    """Judge the error bars and `valid` of records without faults."""
    plant = plant_of(name)
    record = simulate(plant, H, seeds)
    found = score(record, ours_of(record, disturbance_order=order))
    text = f"{name}, {_ms(H)}, r = {order}"
    return [
        Figure(f"{text}: share within 2·std", 0.90, found.covered, "90–92 % at worst", at_least=True),
        Figure(f"{text}: share within 2·std, not more", 0.99, found.covered),
        Figure(f"{text}: largest std, D₀", 1.0, found.largest_std, "72, 213"),
        Figure(f"{text}: share valid", 1.0, found.valid, at_least=True),
    ]


def settling(seeds: Seeds, H: float, once: str) -> list[Figure]:
    """Judge the motor after a step of D₀/2: the time until the error stays within a tenth of it."""
    at = 0.5
    record = simulate(MOTOR, H, seeds, jump(MOTOR, 0.0, 0.5, at), stop_time=1.5)
    found = ours_of(record)
    return [
        Figure(
            f"motor, {_ms(H)}: settling after a step of D₀/2, s",
            0.04,
            settling_time(record, found["at"], at, 0.05),
            once,
        ),
        Figure(
            f"motor, {_ms(H)}: share of the samples that are used", 1.0, float(np.mean(found["valid"])), at_least=True
        ),
    ]


# -- faulty samples


_FAULTS: dict[str, Callable[[Record], Record]] = {
    "clean": lambda record: record,
    "2 % outliers of 50 σ": lambda record: faults.outliers(record, 50.0),
    "2 % outliers of 5000 σ": lambda record: faults.outliers(record, 5000.0),
    "5 % repeated": faults.repeated,
    "12 stuck": faults.stuck,
    "jump of 2 D₀": lambda record: record,
    "jump and outliers": lambda record: faults.outliers(record, 50.0),
}
# Plant, fault, what the first version reached, the limits of RMS and peak.
_FAULTY: tuple[tuple[Any, ...], ...] = (
    (JOINT, "2 % outliers of 50 σ", ".53", 0.050, 0.6),
    (JOINT, "2 % outliers of 5000 σ", "29", 0.050, 0.6),
    (JOINT, "5 % repeated", ".84", 0.050, 0.6),
    (JOINT, "12 stuck", "9.5", 0.050, 0.6),
    (JOINT, "jump of 2 D₀", ".265", 0.18),
    (JOINT, "jump and outliers", ".60", 0.18),
    (CYLINDER, "2 % outliers of 50 σ", "–", 0.006),
    (CYLINDER, "2 % outliers of 5000 σ", "–", 0.006),
    (CYLINDER, "5 % repeated", ".011", 0.006),
    (CYLINDER, "12 stuck", ".019", 0.010),
    (CYLINDER, "jump of 2 D₀", ".249", 0.13),
)


def faulty(
    seeds: Seeds, name: str, fault: str, once: str, limit: float, peak: float | None = None, H: float = 5e-3
) -> list[Figure]:
    """Judge records with faulty samples or a disturbance that jumps."""
    plant = plant_of(name)
    jumps = jump(plant, -1.0, 1.0, 0.5 * plant.stop_time) if fault.startswith("jump") else None
    record = _FAULTS[fault](simulate(plant, H, seeds, jumps))
    estimates = ours_of(record)
    found = score(record, estimates)
    text = f"{name}, {_ms(H)}, {fault}"
    figures = [Figure(text, limit, found.rms, once)]
    if peak is not None:
        figures.append(Figure(f"{text}: peak", peak, found.peak))
    return [*figures, *honesty(record, estimates, text)]


def honesty(record: Record, estimates: dict[str, Any], text: str) -> list[Figure]:
    """Judge `valid`: it is false where the error is beyond three error bars, and does not flap."""
    begin = int(0.3 * len(record.t))
    beyond = np.abs(estimates["ahead"] - record.d_end)[:, begin:, 0] > 3.0 * estimates["std"][:, begin:, 0]
    unseen = float(np.mean(beyond & estimates["valid"][:, begin:]))
    toggles = score(record, estimates).toggles
    seconds = float(record.t[-1] - record.t[begin])
    return [
        Figure(f"{text}: share beyond 3·std with `valid` true", 0.01, unseen),
        Figure(f"{text}: changes of `valid` a second", 4.0, toggles / seconds),
    ]


def _ms(H: float) -> str:
    return f"{H * 1e3:g} ms"


def measured(pattern: str, seeds: Sequence[int], in_parallel: Callable[..., list[Any]], workers: int) -> list[Figure]:
    """Return the figures of all tasks whose name contains the regular expression."""
    jobs = [(_run_named, task.name, tuple(seeds)) for task in tasks(pattern)]
    return [figure for figures in in_parallel("estimator", jobs, workers) for figure in figures]


def _run_named(name: str, seeds: Seeds) -> list[Figure]:
    # A worker gets the name, because plants and faults have functions that cannot be pickled.
    return run(next(task for task in tasks() if task.name == name), seeds)
