"""The encoder: what a sampled, quantised, delayed and sometimes lost measurement makes of an angle."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from ndob_fmu.runtime.blocks.sampled_measurement import SampledMeasurement, SampledState
from ndob_fmu.runtime.times import same_time


@dataclass(frozen=True)
class Encoder(SampledMeasurement):
    """A sampling device for an angle in rad, rounded to 2π / counts_per_revolution; 0 counts: not rounded.

    Samples are taken at t₀ + k sample_time, or with sample_time 0 at the end of every step; where no step ends there,
    at the end of the step across it. Each is shown from `delay` later on, or from the end of the first step after that.
    The points of its state are the samples that are not shown yet, each with the time at which it is due.
    """

    counts_per_revolution: int

    def rounded_to(self) -> float:
        """Return the angle of one count, in rad."""
        return 2.0 * pi / self.counts_per_revolution if self.counts_per_revolution else 0.0

    def step(self, state: SampledState, value: float, t_end: float, step_size: float) -> SampledState:
        """Take the sample that is due at the end of the step, if one is, and show those whose delay is over."""
        pending, slack, latest = state.points, self._slack(t_end, step_size), state.index + 1
        if self.sample_time > 0.0:
            latest = self._latest_index(t_end - state.start_time, slack)
        if latest > state.index:
            pending = (*pending, (t_end + self.delay, self._sample(value, latest)))
        due = sum(time <= t_end + slack for time, _ in pending)
        shown = self._shown(state.good, (sample for _, sample in pending[:due]))
        return SampledState(state.start_time, max(latest, state.index), pending[due:], *shown)

    def possible_points(self, state: SampledState, t: float) -> bool:
        """Return whether no sample is due later than one that is taken now."""
        latest = t + self.delay
        return all(due <= latest or same_time(due, latest) for due, _ in state.points)
