"""π raised over time (the paper's remedy against peaking), and the gain along the way."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import log

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.memo import SharedResults, by_value
from ndob_fmu.runtime.numerics.riccati import lyapunov, solve_riccati_over

_KNOTS_PER_DECADE = 8


@dataclass(frozen=True)
class PiSchedule:
    """π(t) = pi_start (pi_end / pi_start)^{t/ramp_time} for t < ramp_time, then pi_end; t in s since the start."""

    pi_start: float
    pi_end: float
    ramp_time: float

    def __post_init__(self) -> None:
        for name, value in (("pi_start", self.pi_start), ("pi_end", self.pi_end)):
            if not (np.isfinite(value) and value > 0):
                raise DesignError.report(name, expected="a finite number > 0", received=f"{value!r}")
        if not (np.isfinite(self.ramp_time) and self.ramp_time >= 0):
            raise DesignError.report("pi_ramp_time", expected="a finite time ≥ 0 s", received=f"{self.ramp_time!r}")

    def log_pi(self, t: float) -> float:
        """Return ln π(t)."""
        if t >= self.ramp_time:
            return log(self.pi_end)
        return log(self.pi_start) + log(self.pi_end / self.pi_start) * t / self.ramp_time


@dataclass(frozen=True)
class GainTable:
    """L(π) (n,p) at knots of ln π, interpolated by cubic Hermite polynomials through the exact dL/d ln π.

    The derivative solves a Lyapunov equation, A_c Q' + Q' A_cᵀ + π G Gᵀ = 0 with A_c = A + αI − L C. At eight knots a
    decade the interpolated gain is within 1e-5 of the Riccati solution, relative to the largest entry of its column.

    log_pi (k,): the knots, ln π.
    L, dL (k,n,p): the gain and its derivative at the knots.
    coordinates (n,n): those of `RiccatiSolution` at the last knot.
    """

    log_pi: Array = field(repr=False)
    L: Array = field(repr=False)
    dL: Array = field(repr=False)
    coordinates: Array = field(repr=False)

    def gain(self, log_pi: float) -> Array:
        """Return L at ln π; beyond the ends of the table the end's gain."""
        knots = self.log_pi
        if log_pi >= knots[-1]:
            return np.asarray(self.L[-1])
        i = int(knots.searchsorted(log_pi, side="right")) - 1
        if i < 0:
            return np.asarray(self.L[0])
        h = knots[i + 1] - knots[i]
        s = (log_pi - knots[i]) / h
        r = 1.0 - s
        return np.asarray(
            r * r * (1.0 + 2.0 * s) * self.L[i]
            + s * s * (1.0 + 2.0 * r) * self.L[i + 1]
            + h * s * r * (r * self.dL[i] - s * self.dL[i + 1])
        )


_TABLES: SharedResults[GainTable] = SharedResults(16)


def gain_table(linear: LinearPart, schedule: PiSchedule, *, alpha: float) -> GainTable:
    """Solve eq. (8)/(24) along the schedule. Raises DesignError where one of the solutions cannot be trusted."""
    return _TABLES(by_value((linear, schedule, alpha)), lambda: _gain_table(linear, schedule, alpha))


def _gain_table(linear: LinearPart, schedule: PiSchedule, alpha: float) -> GainTable:
    low, high = sorted((schedule.pi_start, schedule.pi_end))
    if schedule.ramp_time == 0.0 or low == high:
        pis = np.array([schedule.pi_end])
    else:
        pis = np.geomspace(low, high, int(np.ceil(_KNOTS_PER_DECADE * np.log10(high / low))) + 1)
    G, C = linear.G, linear.C
    L, dL = [], []
    for solution in solve_riccati_over(linear.A, C, G, pis=pis, alpha=alpha):
        T = solution.coordinates
        closed = np.linalg.solve(T, (linear.A + alpha * np.eye(len(T)) - solution.Q @ C.T @ C) @ T)
        G_s = np.sqrt(solution.pi) * np.linalg.solve(T, G)
        L.append(solution.Q @ C.T)
        dL.append(T @ lyapunov(closed, G_s @ G_s.T) @ T.T @ C.T)
    return GainTable(log_pi=np.log(pis), L=np.array(L), dL=np.array(dL), coordinates=T)
