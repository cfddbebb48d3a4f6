"""The gains of the paper's observer along the schedule of π, and the error bar that goes with them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.gains import orthogonal_factor
from ndob_fmu.runtime.design.schedule import GainTable, PiSchedule
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.memo import LatestResult


@dataclass(frozen=True)
class ScheduledGains:
    """All that the observer takes from the design, as functions of ln π.

    linear: the plant's matrices.
    schedule: π over time.
    table: L over ln π.
    noise_std (p,): σ of a sample of each output, for the error bar; empty for none.
    disturbance_bound (q2,): D₀, for the error bar; empty for none.
    """

    linear: LinearPart
    schedule: PiSchedule
    table: GainTable = field(repr=False)
    noise_std: Vector
    disturbance_bound: Vector
    # π stays the same after its ramp, and so do these.
    _to_w: LatestResult[Array] = field(default_factory=LatestResult, repr=False, compare=False)
    _d_std: LatestResult[Array] = field(default_factory=LatestResult, repr=False, compare=False)

    def output_to_w(self, log_pi: float) -> Array:
        """Return √π W (q,p), which makes ŵ of an output error, eqs. (6) and (23)."""
        return self._to_w(
            (log_pi,), lambda: np.exp(0.5 * log_pi) * orthogonal_factor(self.linear, self.table.gain(log_pi))
        )

    def disturbance_std(self, log_pi: float) -> Array:
        """Return the error bar (q2,) of d̂.

        It is the noise of the samples times √π, together with the error that W leaves of a constant |d| = D₀.
        """

        def compute() -> Array:
            linear, L = self.linear, self.table.gain(log_pi)
            gain = linear.selector @ self.output_to_w(log_pi)
            constant = gain @ linear.C @ np.linalg.solve(L @ linear.C - linear.A, linear.G_d)
            bias = np.abs(constant - np.eye(len(constant))) @ np.array(self.disturbance_bound or [0.0] * len(constant))
            noise = np.linalg.norm(gain * np.array(self.noise_std or [0.0] * len(linear.C)), axis=1)
            return np.asarray(np.sqrt(noise * noise + bias * bias))

        return self._d_std((log_pi,), compute)
