"""The encoder: what a sampled, quantised, delayed and sometimes lost measurement makes of an angle."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from ndob_fmu.runtime.blocks.sampled_measurement import SampledState, Sampling, is_possible, slack_of
from ndob_fmu.runtime.times import same_time


@dataclass(frozen=True)
class Encoder:
    """A sampling device for an angle in rad.

    Samples are taken at t₀ + k sample_time, or with sample_time 0 at the end of every step; where no step ends there,
    at the end of the step across it. Each is shown from `delay` later on, or from the end of the first step after that.
    The points of its state are the samples that are not shown yet, each with the time at which it is due.
    """

    sampling: Sampling

    def init(self, value: float, t: float) -> SampledState:
        """Return the state that shows the first sample, of the value at t."""
        return self.sampling.start(value, t)

    def step(self, state: SampledState, value: float, t_end: float, step_size: float) -> SampledState:
        """Take the sample that is due at the end of the step, if one is, and show those whose delay is over."""
        sampling, slack, latest = self.sampling, slack_of(t_end, step_size), state.index + 1.0
        times, values = state.times, state.values
        if sampling.sample_time > 0.0:
            latest = sampling.latest_index(t_end - state.start_time, slack)
        if latest > state.index:
            times = (*times, t_end + sampling.delay)
            values = (*values, sampling.sample(value, latest))
        due = 0
        for time in times:
            if time <= t_end + slack:
                due += 1
        good, shown, new = sampling.shown(state.good, values[:due])
        latest = max(latest, state.index)
        return SampledState(state.start_time, latest, times[due:], values[due:], good, shown, new)

    def possible(self, state: SampledState, t: float) -> bool:
        """Return whether numbers in the form of a state can be one at the time t (s).

        No sample is due later than one that is taken now.
        """
        latest = t + self.sampling.delay
        return is_possible(state) and all(due <= latest or same_time(due, latest) for due in state.times)


def angle_of_a_count(counts_per_revolution: int) -> float:
    """Return the angle (rad) of one count, the resolution; 0 counts: not rounded."""
    return 2.0 * pi / counts_per_revolution if counts_per_revolution else 0.0
