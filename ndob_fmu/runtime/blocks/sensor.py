"""The sensor: a sampled, quantised, delayed and sometimes lost measurement of any quantity."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from operator import itemgetter

from ndob_fmu.runtime.blocks.sampled_measurement import SampledMeasurement, SampledState
from ndob_fmu.runtime.times import same_time

_SAME_TIME = 1e-6  # part of a step by which the end of a step may miss the time of a sample


@dataclass(frozen=True)
class Sensor(SampledMeasurement):
    """A sampling device for any quantity, rounded to a multiple of `resolution`; 0: not rounded.

    Samples are taken at t₀ + k sample_time, and shown at the end of the first step that ends `delay` later or after
    that. With sample_time 0 a step that ends at t shows the sample of t − delay. Neither times nor delay need be
    multiples of the step: between two ends of steps the quantity is on the line through its values there.
    If several samples become due in one step, the last one is shown.
    The points of its state are the values at the ends of steps, from the last one on that is `delay` ago.
    """

    resolution: float

    def rounded_to(self) -> float:
        """Return the resolution."""
        return self.resolution

    def init(self, value: float, t: float) -> SampledState:
        """Return the state that shows the first sample, of the value at t."""
        return replace(super().init(value, t), points=((t, value),))

    def step(self, state: SampledState, value: float, t_end: float, step_size: float) -> SampledState:
        """Take the value at the end of the step, and show the last sample whose delay is over, if it is a new one."""
        points, slack = (*state.points, (t_end, value)), self._slack(t_end, step_size)
        at = t_end - self.delay
        if self.sample_time > 0.0:
            latest = max(self._latest_index(at - state.start_time, slack), state.index)
            taken = state.start_time + latest * self.sample_time
        else:
            latest = state.index + (at > state.start_time + slack)
            taken = at
        samples = [self._sample(_value_at(points, taken), latest)] if latest > state.index else []
        oldest = max(bisect_right(points, at, key=itemgetter(0)) - 1, 0)
        return SampledState(state.start_time, latest, points[oldest:], *self._shown(state.good, samples))

    def possible_points(self, state: SampledState, t: float) -> bool:
        """Return whether the last point is that of t, and no other than the first is older than the delay."""
        times, at = [time for time, _ in state.points], t - self.delay
        return bool(times) and same_time(times[-1], t) and all(time > at or same_time(time, at) for time in times[1:])


def _value_at(points: tuple[tuple[float, float], ...], t: float) -> float:
    """Return the value at t (s) on the line through the points (s, value) around it; outside of them the nearest."""
    after = bisect_right(points, t, key=itemgetter(0))
    if after in (0, len(points)):
        return points[max(after - 1, 0)][1]
    (begin, first), (end, second) = points[after - 1 : after + 1]
    share = (t - begin) / (end - begin)
    if share <= _SAME_TIME:
        return first
    return second if share >= 1.0 - _SAME_TIME else (1.0 - share) * first + share * second
