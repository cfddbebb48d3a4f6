"""Measures: the numbers that a study keeps of each run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ndob_fmu.results.recording import Recording
from ndob_fmu.runtime.arrays import Array

_TAKE: dict[str, Callable[[Array], float]] = {
    "final": lambda x: float(x[-1]),
    "min": lambda x: float(np.min(x)),
    "max": lambda x: float(np.max(x)),
    "mean": lambda x: float(np.mean(x)),
    "max_abs": lambda x: float(np.max(np.abs(x))),
    "rms": lambda x: float(np.sqrt(np.mean(np.square(x)))),
    "std": lambda x: float(np.std(x)),
}
SETTLING_TIME = "settling_time"
TAKES = (*_TAKE, SETTLING_TIME)


@dataclass(frozen=True)
class Measure:
    """One number of a recording: ``take`` of the signal ``of``, minus the signal ``minus`` if that is given.

    take: one of ``TAKES``.
    after: only rows from this time on count, in s.
    within: for ``settling_time``, a share of the largest |minus|, or without ``minus`` of the largest |of|.

    ``settling_time`` is the time in s from which on the value stays within that share of 0, or without ``minus`` of its
    last value; infinite if it never does.
    """

    of: str
    take: str
    minus: str | None = None
    after: float | None = None
    within: float = 0.02

    def __call__(self, recording: Recording) -> float:
        """Return the number; NaN where the signal is not finite or there is no row after ``after``."""
        first = 0 if self.after is None else int(np.searchsorted(recording.time, self.after - 1e-12))
        time = recording.time[first:]
        value = recording[self.of][first:].astype(np.float64)
        reference = value if self.minus is None else recording[self.minus][first:].astype(np.float64)
        if self.minus is not None:
            value = value - reference
        if not len(time) or not np.isfinite(value).all():
            return float("nan")
        if self.take != SETTLING_TIME:
            return _TAKE[self.take](value)
        target = 0.0 if self.minus is not None else value[-1]
        outside = np.flatnonzero(np.abs(value - target) > self.within * np.max(np.abs(reference)))
        if not len(outside):
            return float(time[0])
        return float(time[outside[-1] + 1]) if outside[-1] + 1 < len(time) else float("inf")
