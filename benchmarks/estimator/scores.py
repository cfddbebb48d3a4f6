"""The numbers that judge estimates, over all records of a cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.estimator.plants import Array
from benchmarks.estimator.records import Record

STEADY_FROM = 0.3  # of a record


@dataclass(frozen=True)
class Score:
    """How well an estimator did, errors in D₀.

    rms: of d̂ at the sample
    peak: the largest error there
    covered: share of the predictions within two error bars
    largest_std: the largest error bar of the whole record
    valid: share of the samples; toggles: how often `valid` changes in a record
    """

    rms: float
    peak: float
    covered: float = float("nan")
    largest_std: float = float("nan")
    valid: float = float("nan")
    toggles: float = float("nan")


def score(record: Record, found: dict[str, Array], begin: float = STEADY_FROM) -> Score:
    """Return the score of estimates with the record as first axis, from a share `begin` of the record on."""
    first, bound = int(begin * len(record.t)), record.plant.bound
    error = (found["at"] - record.d)[:, first:] / bound
    values: dict[str, float] = {}
    if "std" in found:
        ahead = np.abs(found["ahead"] - record.d_end)[:, first:]
        values["covered"] = float(np.mean(ahead <= 2.0 * found["std"][:, first:]))
        values["largest_std"] = float(np.max(found["std"] / bound))
    if "valid" in found:
        valid = found["valid"][:, first:]
        values["valid"] = float(np.mean(valid))
        values["toggles"] = float(np.mean(np.sum(valid[:, 1:] != valid[:, :-1], axis=1)))
    return Score(rms(error), float(np.max(np.abs(error))), **values)


def rms(error: Array) -> float:
    """Return the root of the mean square; NaN, for a filter that has diverged, stays NaN."""
    return float(np.sqrt(np.mean(error**2)))


def settling_time(record: Record, at: Array, begin: float, band: float) -> float:
    """Return the longest time (s) after `begin` (s) from which d̂ stays within `band` (D₀); inf where it never does."""
    outside = np.abs(at - record.d)[:, :, 0] > band * record.plant.bound
    outside &= record.t >= begin - 1e-9
    last = [np.flatnonzero(row) for row in outside]
    if any(len(row) and row[-1] == len(record.t) - 1 for row in last):
        return float("inf")
    return max(float(record.t[row[-1] + 1]) - begin if len(row) else 0.0 for row in last)
