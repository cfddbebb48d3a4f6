"""The measured record, pulses of force that are made in it, and how well estimates find them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from benchmarks.emps.model import model
from ndob_fmu.errors import UsageError
from ndob_fmu.results.recording import Recording
from ndob_fmu.runtime.arrays import Array

FORCE = 176.0  # N, of a pulse: 5 V of the drive
LAG = 0.02  # s
# s: what an online estimate cannot know begins with an edge, and what later samples tell begins before it.
BEFORE, AFTER = 0.025, 0.06
_START = 0.2  # s, that are not judged
_PULSES, _PAUSES, _FIRST = (0.15, 0.5), (0.3, 1.2), 0.5  # s


@dataclass(frozen=True)
class Measured:
    """The record: t (K,) in s, position (K,) in m, voltage (K,) in V of the drive."""

    t: Array
    position: Array
    voltage: Array


def read(path: str | Path) -> Measured:
    """Read DATA_EMPS.mat; raise UsageError for another file."""
    try:
        found = loadmat(path)
        return Measured(*(np.array(found[name].ravel(), dtype=float) for name in ("t", "qm", "vir")))
    except (OSError, ValueError, KeyError, NotImplementedError, MatReadError) as error:
        raise UsageError.report(str(path), expected="DATA_EMPS.mat with t, qm and vir", received=str(error)) from error


def pulses(t: Array, seed: int) -> Array:
    """Return the force (K,) of the pulses, FORCE with either sign."""
    random, force, begin = np.random.default_rng(seed), np.zeros(len(t)), t[0] + _FIRST
    while begin < t[-1]:
        end = begin + random.uniform(*_PULSES)
        force[(t >= begin) & (t < end)] = FORCE * random.choice([-1.0, 1.0])
        begin = end + random.uniform(*_PAUSES)
    return force


def write_log(path: Path, measured: Measured, force: Array) -> None:
    """Write the record as a log whose voltage lacks this force (K,), so that the observer does not know it."""
    voltage = measured.voltage - force / model.parameters["gain"]
    rows = np.column_stack([measured.t, voltage, measured.position]).tolist()
    lines = [",".join(map(repr, row)) for row in rows]
    path.write_text("\n".join(["time,voltage,position", *lines, ""]), "utf-8", newline="\n")


@dataclass(frozen=True)
class Estimate:
    """A column of estimates (K,) with its error bar (K,), and the force (K,) at the time that each is for, in N."""

    title: str
    value: Array
    std: Array
    true: Array


def estimates(result: Recording, force: Array) -> list[Estimate]:
    """Return the four estimates of a result of `estimate` beside the force (K,) that was made."""
    # Row k holds what the step from row k − 1 to it said, so that the sample is that of row k − 1.
    late = 1 + round(LAG / float(np.median(np.diff(result.time))))
    online_std = result["observer.force_std"]
    return [
        Estimate("online, at the sample", result["observer.force_at_sample"], online_std, _delayed(force, 1)),
        Estimate("online, for the next sample", result["observer.force_hat"], online_std, force),
        Estimate(
            f"at a lag of {1e3 * LAG:g} ms",
            result["observer.force_lagged"],
            result["observer.force_lagged_std"],
            _delayed(force, late),
        ),
        Estimate("smoothed", result["smoother.force"], result["smoother.force_std"], force),
    ]


def known_online(online: Estimate, rows: int) -> Estimate:
    """Return the force as samples without noise tell it, so many rows late: no online estimate can know more.

    A force moves the position from the sample after its edge on: one row for the estimate at the sample, another for
    the one that predicts the next sample.
    """
    return replace(online, value=_delayed(online.true, rows))


def _delayed(values: Array, rows: int) -> Array:
    return np.concatenate([np.full(rows, values[0]), values[:-rows]])


@dataclass(frozen=True)
class Score:
    """Of an estimate: its RMS error (N), that away from the edges, and the share of errors within 2·std."""

    rms: float
    away: float
    covered: float


def score(t: Array, one: Estimate) -> Score:
    """Judge an estimate at the times t (K,)."""
    error, judged = one.value - one.true, t >= t[0] + _START
    away = judged.copy()
    for edge in t[1:][np.diff(one.true) != 0.0]:
        away &= (t < edge - BEFORE) | (t > edge + AFTER)
    return Score(
        rms=float(np.sqrt(np.mean(error[judged] ** 2))),
        away=float(np.sqrt(np.mean(error[away] ** 2))),
        covered=float(np.mean(np.abs(error[judged]) <= 2.0 * one.std[judged])),
    )
