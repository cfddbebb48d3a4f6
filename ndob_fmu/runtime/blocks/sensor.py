"""The sensor: a sampled, quantised, delayed and sometimes lost measurement of any quantity."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ndob_fmu.runtime.blocks.sampled_measurement import SampledState, Sampling, is_possible, slack_of
from ndob_fmu.runtime.times import same_time

_SAME_TIME = 1e-6  # part of a step by which the end of a step may miss the time of a sample


@dataclass(frozen=True)
class Sensor:
    """A sampling device for any quantity.

    Samples are taken at t₀ + k sample_time, and shown at the end of the first step that ends `delay` later or after
    that. With sample_time 0 a step that ends at t shows the sample of t − delay. Neither times nor delay need be
    multiples of the step: between two ends of steps the quantity is on the line through its values there.
    If several samples become due in one step, the last one is shown.
    The points of its state are the values at the ends of steps, from the last one on that is `delay` ago.
    """

    sampling: Sampling

    def init(self, value: float, t: float) -> SampledState:
        """Return the state that shows the first sample, of the value at t."""
        return replace(self.sampling.start(value, t), times=(t,), values=(value,))

    def step(self, state: SampledState, value: float, t_end: float, step_size: float) -> SampledState:
        """Take the value at the end of the step, and show the last sample whose delay is over, if it is a new one."""
        sampling = self.sampling
        times, values = [*state.times, t_end], [*state.values, value]
        slack, at = slack_of(t_end, step_size), t_end - sampling.delay
        latest, taken = state.index, at
        if sampling.sample_time > 0.0:
            latest = max(sampling.latest_index(at - state.start_time, slack), latest)
            taken = state.start_time + latest * sampling.sample_time
        elif at > state.start_time + slack:
            latest = latest + 1.0
        samples: list[float] = []
        if latest > state.index:
            samples.append(sampling.sample(_value_at(times, values, taken), latest))
        oldest = max(bisect_right(times, at) - 1, 0)
        good, shown, new = sampling.shown(state.good, samples)
        return SampledState(state.start_time, latest, tuple(times[oldest:]), tuple(values[oldest:]), good, shown, new)

    def possible(self, state: SampledState, t: float) -> bool:
        """Return whether numbers in the form of a state can be one at the time t (s).

        The last point is that of t, and no other than the first is older than the delay.
        """
        if not is_possible(state) or not state.times or not same_time(state.times[-1], t):
            return False
        at = t - self.sampling.delay
        return all(time > at or same_time(time, at) for time in state.times[1:])


def _value_at(times: Sequence[float], values: Sequence[float], t: float) -> float:
    """Return the value at t (s) on the line through the points around it; outside of them the nearest."""
    after = bisect_right(times, t)
    if after in (0, len(times)):
        return values[max(after - 1, 0)]
    begin, end = times[after - 1], times[after]
    share = (t - begin) / (end - begin)
    if share <= _SAME_TIME:
        return values[after - 1]
    if share >= 1.0 - _SAME_TIME:
        return values[after]
    return (1.0 - share) * values[after - 1] + share * values[after]
