"""The cells of the page: good samples, faulty ones, half-true statements, a lag; ours beside the others in each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.estimator import faults
from benchmarks.estimator.alternatives import (
    bandwidths,
    best,
    extended_state_observer,
    lipschitz_bounds,
    robust_differentiator,
)
from benchmarks.estimator.fault_rows import FAULTS, faulty_record
from benchmarks.estimator.gallery_rows import step_of
from benchmarks.estimator.kalman import UnscentedKalmanFilter, ekf, smoothed, tuned_intensity
from benchmarks.estimator.ours import Estimates, NotAvailableError, RefusedError, ours_of, published_intensity
from benchmarks.estimator.plants import ARM, CYLINDER, JOINT, MOTOR, Array, Plant
from benchmarks.estimator.records import Record, simulate, sine
from benchmarks.estimator.scores import Score, score
from benchmarks.estimator.statement_rows import EXACT_SIGMA, UNCERTAINTY, drawn, told_noise
from benchmarks.estimator.tasks import Seeds, ms
from benchmarks.gallery.plants import gallery_plants

GOOD, FAULTY, WRONG, LATER, SHOWN = "good", "faulty", "wrong", "later", "shown"
H = 5e-3
STEPS = {JOINT: (1e-3, 5e-3, 2e-2), CYLINDER: (1e-3, 5e-3, 2e-2), MOTOR: (1e-3, 5e-3, 2e-2), ARM: (1e-3, 5e-3, 1e-2)}
LAGS = (1, 2, 5, 10, 20)  # steps


@dataclass(frozen=True)
class Cell:
    """One cell: `record` makes its records from the seeds.

    sigma: (p,) as told to ours and to the Kalman filter where it differs from the plant's
    told: FMU parameters besides those of every cell
    told_step: the step (s) that the observers are told where it is not the true one
    lag: steps by which the estimate may be late
    """

    group: str
    plant: Plant
    text: str
    record: Callable[[Seeds], Record]
    sigma: Array | None = None
    told: dict[str, Any] = field(default_factory=dict)
    told_step: float | None = None
    lag: int = 0


Scores = dict[str, Score | str]  # by estimator; a text says why there is no score


def cells(few: int | None = None, plants: Sequence[Plant] = (JOINT, CYLINDER, MOTOR, ARM)) -> list[Cell]:
    """Return all cells of these plants and the gallery's, or a few of each kind, those with the longest steps.

    The arm has good samples only.
    """
    last = None if few is None else -few
    three = [plant for plant in plants if plant is not ARM]
    return [
        *(
            Cell(GOOD, plant, ms(step), lambda seeds, plant=plant, step=step: simulate(plant, step, seeds))
            for plant in plants
            for step in STEPS[plant][last:]
        ),
        *(
            Cell(FAULTY, plant, name, lambda seeds, plant=plant, name=name: faulty_record(plant, name, seeds))
            for plant in three
            for name in list(FAULTS)[:few]
        ),
        *(cell for plant in three for cell in _wrong(plant)[:few]),
        *(
            Cell(LATER, plant, ms(lag * H), _good(plant), told={"lag": lag * H}, lag=lag)
            for plant in three
            for lag in LAGS[:few]
        ),
        *(
            Cell(SHOWN, plant, ms(step_of(plant)), lambda seeds, plant=plant: simulate(plant, step_of(plant), seeds))
            for plant in (gallery_plants() if few is None else sorted(gallery_plants(), key=step_of)[last:])
        ),
    ]


def _good(plant: Plant) -> Callable[[Seeds], Record]:
    return lambda seeds: simulate(plant, H, seeds)


def _wrong(plant: Plant) -> list[Cell]:
    """Return the cells in which something that the observers are told is not quite true."""
    exact = np.full(len(plant.C), EXACT_SIGMA)
    std = {f"{key}_std": UNCERTAINTY * abs(value) for key, value in plant.parameters.items()}
    fifth = {key: 1.2 * value for key, value in plant.parameters.items()}
    good = _good(plant)

    def uncertain(seeds: Seeds) -> Record:
        return drawn(plant, seeds)

    def jittering(seeds: Seeds) -> Record:
        return simulate(plant, faults.jittering(H, plant.stop_time, seeds[0]), seeds)

    def cell(text: str, record: Callable[[Seeds], Record], **more: Any) -> Cell:
        return Cell(WRONG, plant, text, record, **more)

    return [
        cell("noise told 1/10", good, sigma=0.1 * plant.sigma),
        cell("noise told 10 ×", good, sigma=10.0 * plant.sigma),
        cell("quantised to 20 σ", lambda seeds: faults.quantised(good(seeds))),
        cell("parameters ± 10 %, not told", uncertain, sigma=exact),
        cell("parameters ± 10 %, told", uncertain, sigma=exact, told=std),
        cell("parameters ± 10 %, estimated", uncertain, sigma=exact, told=std | {"estimate_parameters": True}),
        cell("all parameters told 17 % too small", lambda seeds: simulate(plant, H, seeds, parameters=fifth)),
        cell("d of amplitude 3 D₀", lambda seeds: simulate(plant, H, seeds, sine(plant, 3.0))),
        cell("20 % of the samples lost", lambda seeds: faults.lost(good(seeds), 0.2)),
        cell("H ± 30 %, told", jittering),
        cell("H ± 30 %, told 5 ms", jittering, told_step=H),
    ]


def compared(cell: Cell, seeds: Seeds) -> Scores:
    """Return the scores of the estimators of a cell."""
    plant, record = cell.plant, cell.record(seeds)
    told = record if cell.told_step is None else replace(record, steps=np.full_like(record.steps, cell.told_step))
    noise = {} if cell.sigma is None else told_noise(plant, cell.sigma)
    scores: Scores = {"ours": _ours(record, told, cell.lag, noise | cell.told)}
    if cell.lag:
        before = smoothed(record, cell.lag, intensity=published_intensity(plant, record.H))["at"]
        scores["EKF"] = score(_earlier(record, cell.lag), {"at": before[:, : -cell.lag]})
        return scores
    sigma = tuple((plant.sigma if cell.sigma is None else cell.sigma).tolist())
    intensity = tuned_intensity(plant, H if cell.group == WRONG else record.H, 2, sigma)
    scores["EKF"] = score(record, ekf(_at_told_times(told), sigma=cell.sigma, intensity=intensity))
    if cell.group == SHOWN:
        intensity = published_intensity(plant, record.H)
        scores["EKF, same"] = score(record, ekf(record, intensity=intensity))
    if cell.group == GOOD:
        if plant is not ARM:  # ours estimates the arm's torques, with intensities of theirs
            intensity = published_intensity(plant, record.H)
            scores["EKF, same"] = score(record, ekf(record, intensity=intensity))
        scores["UKF"] = score(record, ekf(record, intensity=intensity, kind=UnscentedKalmanFilter))
        for name, estimator, tunings in (
            ("ESO", extended_state_observer, bandwidths(record)),
            ("differentiator", robust_differentiator, lipschitz_bounds(record)),
        ):
            scores[name] = score(record, {"at": best(record, estimator, tunings)[0]})
    return scores


def _ours(record: Record, told: Record, late: int, fmu_parameters: dict[str, Any]) -> Score | str:
    try:
        found = ours_of(told, **fmu_parameters)
    except NotAvailableError as error:
        return f"not available: {error}"
    except RefusedError as error:
        return f"refused: {error}"
    if not late:
        return score(record, found)
    if "lagged" not in found:
        return "not available: a lagged estimate"
    error_bars = {"ahead": found["lagged"], "std": found["lagged_std"]}
    part: Estimates = {"at": found["lagged"], "valid": found["valid"], **error_bars}
    return score(_earlier(record, late), {key: value[:, late:] for key, value in part.items()})


def _earlier(record: Record, lag: int) -> Record:
    """Return the record without its last `lag` samples, as the truth of an estimate that is so late."""
    d = record.d[:-lag]
    return replace(record, t=record.t[:-lag], steps=record.steps[:-lag], d=d, d_end=d)


def _at_told_times(record: Record) -> Record:
    """Return the record with the times that its steps add up to."""
    return replace(record, t=np.concatenate([[0.0], np.cumsum(record.steps)[:-1]]))
