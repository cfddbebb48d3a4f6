"""The disturbance source: the generator's kinds, and besides band-limited noise and a profile from a file.

All are functions of continuous time alone, so that no communication step and no order of steps changes them.
"""

from __future__ import annotations

import csv
import os
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import cos, isfinite, pi, sqrt
from stat import S_ISREG

from ndob_fmu.runtime.base_errors import NdobError
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.random_numbers import uniforms

SOURCE_KINDS = {**KINDS, "noise": 6, "profile": 7}
INTERPOLATIONS = {"linear": 1, "held": 2}
NOISE_TONES = 256

Signal = Callable[[float], float]


@dataclass(frozen=True)
class Noise:
    """Band-limited Gaussian noise from `start_time` on, 0 before: with N = 256 tones and τ = t − start_time in s

        d(t) = amplitude √(2/N) Σᵢ cos(2π fᵢ τ + φᵢ),   fᵢ in the i-th N-th of the band from 0 to `frequency` (Hz),

    where the seed draws each fᵢ and φᵢ uniformly. The standard deviation is `amplitude`, the one-sided power spectral
    density amplitude²/frequency inside the band and 0 above. A record longer than N/frequency tells the tones apart.
    """

    amplitude: float
    frequency: float
    start_time: float
    rates: tuple[float, ...]
    phases: tuple[float, ...]

    def __call__(self, t: float) -> float:
        """Return d(t)."""
        tau = t - self.start_time
        if tau < 0.0:
            return 0.0
        total = 0.0
        for rate, phase in zip(self.rates, self.phases, strict=True):
            total += cos(rate * tau + phase)
        return self.amplitude * sqrt(2.0 / NOISE_TONES) * total


def noise(*, amplitude: float, frequency: float, start_time: float, seed: int) -> Noise:
    """Draw the tones of a noise."""
    rates: list[float] = []
    phases: list[float] = []
    for i in range(NOISE_TONES):
        drawn = uniforms(seed, float(i))
        rates.append(2.0 * pi * frequency / NOISE_TONES * (float(i) + drawn[0]))
        phases.append(2.0 * pi * drawn[1])
    return Noise(amplitude, frequency, start_time, tuple(rates), tuple(phases))


@dataclass(frozen=True)
class Profile:
    """amplitude × the value of a table at τ = t − start_time, 0 before start_time.

    times (s, ascending) and values have the same length. Between the rows: on the line through them, or, if `held`,
    the row before. Before the first row its value holds, after the last one that one's.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]
    held: bool
    amplitude: float = 1.0
    start_time: float = 0.0

    def __call__(self, t: float) -> float:
        """Return d(t)."""
        tau = t - self.start_time
        if tau < 0.0:
            return 0.0
        after = bisect_right(self.times, tau)
        before = max(after - 1, 0)
        if self.held or after in (0, len(self.times)):
            return self.amplitude * self.values[before]
        begin, end = self.times[before], self.times[after]
        share = (tau - begin) / (end - begin)
        return self.amplitude * ((1.0 - share) * self.values[before] + share * self.values[after])


def read_profile(path: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return times (s) and values from the first two columns of a CSV file; a first row without numbers is a heading.

    Raises NdobError where there is no such file, a row has no two finite numbers, or times do not ascend.
    """
    likely = "the path is relative to the folder in which the host runs; give it whole"
    try:
        if not S_ISREG(os.stat(path).st_mode):  # noqa: PTH116 # as below
            raise ValueError("it is no regular file")
        with open(path, encoding="utf-8-sig", newline="") as file:  # noqa: PTH123 # an empty Path would be a folder
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, ValueError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else f"{error}"
        raise NdobError.report(
            "disturbance.profile",
            expected="the path of a CSV file with columns time and value",
            received=f"{path!r} ({reason})",
            likely=likely if isinstance(error, FileNotFoundError) else "",
        ) from error
    if rows and _numbers(rows[0]) is None:
        del rows[0]
    table = []
    for number, row in enumerate(rows, start=1):
        pair = _numbers(row)
        if pair is None:
            text = ",".join(row)
            raise NdobError.report(
                f"disturbance.profile {path}, data row {number}",
                expected="two finite numbers, time and value",
                received=repr(text),
            )
        table.append(pair)
    if not table:
        raise NdobError.report(f"disturbance.profile {path}", expected="at least one row", received="none")
    for (before, _), (after, _) in pairwise(table):
        if not after > before:
            raise NdobError.report(
                f"disturbance.profile {path}", expected="times that ascend", received=f"{after:g} after {before:g}"
            )
    times, values = zip(*table, strict=True)
    return times, values


def _numbers(row: list[str]) -> tuple[float, float] | None:
    try:
        time, value = float(row[0]), float(row[1])
    except (ValueError, IndexError):
        return None
    return (time, value) if isfinite(time) and isfinite(value) else None


def disturbance_source(
    kind: int, *, amplitude: float, frequency: float, start_time: float, seed: int, profile: str, interpolation: int
) -> Signal:
    """Return d(t) of this kind, one of SOURCE_KINDS. Raises NdobError where a profile cannot be read."""
    if kind == SOURCE_KINDS["noise"]:
        return noise(amplitude=amplitude, frequency=frequency, start_time=start_time, seed=seed)
    if kind == SOURCE_KINDS["profile"]:
        times, values = read_profile(profile)
        return Profile(times, values, interpolation == INTERPOLATIONS["held"], amplitude, start_time)
    return Generator(kind, amplitude, frequency, start_time)
