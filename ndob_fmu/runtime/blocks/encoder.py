"""The encoder: what a sampled, quantised, delayed and sometimes lost measurement makes of an angle."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import floor, isfinite, nan, pi, ulp

from ndob_fmu.runtime.blocks.random_numbers import normal, uniforms
from ndob_fmu.runtime.times import same_time

MISSING = {"held": 1, "not_a_number": 2}

# Hosts add up their times, or round them. A sample or a value that is due within this part of a period or of a step
# after the step's end, or within this many roundings of its time, must not slip to the next step.
_OF_A_PERIOD, _OF_A_STEP, _ROUNDINGS = 1e-6, 1e-3, 4.0
_LARGEST_INDEX = 2**53  # beyond it times do not tell samples apart


@dataclass(frozen=True)
class EncoderState:
    """`start_time` (s); `index` of the last sample; `pending` samples, each with the time (s) at which it is due, NaN
    for one that is lost; the last `good` value that was shown; what is `shown` now, and whether that is a `new` sample.
    """

    start_time: float
    index: int
    pending: tuple[tuple[float, float], ...] = field(metadata={"grows": True})
    good: float
    shown: float
    new: bool


@dataclass(frozen=True)
class Encoder:
    """init(angle, t₀) → state; step(state, angle, t_end, step_size) → state. Angles in rad, times in s.

    A sample is round((angle + bias + noise) / LSB) LSB, with LSB = 2π / counts_per_revolution (0 counts: not rounded)
    and noise drawn from `seed` and the sample's index. Samples are taken at t₀ + k sample_time, or with sample_time 0
    at the end of every step; where no step ends there, at the end of the step across it. Each is shown from `delay`
    later on, or from the end of the first step after that. Between samples, and for one that is lost (with
    `dropout_probability`, or because the angle is not finite), the value before is held, or NaN is shown if
    `between_samples_nan` or `dropped_nan`. The first sample, taken at t₀, is not dropped and shown at once.
    """

    counts_per_revolution: int
    noise_std: float
    bias: float
    seed: int
    sample_time: float
    delay: float
    dropout_probability: float
    between_samples_nan: bool
    dropped_nan: bool

    def init(self, angle: float, t: float) -> EncoderState:
        """Return the state that shows the first sample, of the angle at t."""
        first = self._measured(angle, 0)
        return EncoderState(start_time=t, index=0, pending=(), good=first, shown=first, new=isfinite(first))

    def step(self, state: EncoderState, angle: float, t_end: float, step_size: float) -> EncoderState:
        """Take the sample that is due at the end of the step, if one is, and show those whose delay is over."""
        index, pending = state.index, state.pending
        slack = max(_OF_A_STEP * step_size, _ROUNDINGS * ulp(t_end))
        latest = index + 1
        if self.sample_time > 0.0:
            since = t_end - state.start_time + max(slack, _OF_A_PERIOD * self.sample_time)
            latest = floor(since / self.sample_time)
        if latest > index:
            index, pending = latest, (*pending, (t_end + self.delay, self._sample(angle, latest)))
        due = sum(time <= t_end + slack for time, _ in pending)
        good, shown = state.good, nan if self.between_samples_nan else state.good
        new = False
        for _, value in pending[:due]:
            new = isfinite(value)
            good = value if new else good
            shown = value if new or self.dropped_nan else good
        return EncoderState(state.start_time, index, pending[due:], good, shown, new)

    def possible(self, state: EncoderState, t: float) -> bool:
        """Return whether numbers in the form of a state can be one at the time t (s)."""
        if not all(isinstance(sample, tuple) and [*map(type, sample)] == [float, float] for sample in state.pending):
            return False
        due = [time for time, _ in state.pending]
        in_order = due == sorted(due) and all(time <= t + self.delay or same_time(time, t + self.delay) for time in due)
        return in_order and 0 <= state.index <= _LARGEST_INDEX and isfinite(state.start_time)

    def _sample(self, angle: float, index: int) -> float:
        lost = uniforms(self.seed, index)[2] < self.dropout_probability
        return nan if lost else self._measured(angle, index)

    def _measured(self, angle: float, index: int) -> float:
        first, second, *_ = uniforms(self.seed, index)
        value = angle + self.bias + self.noise_std * normal(first, second)
        if self.counts_per_revolution == 0 or not isfinite(value):
            return value if isfinite(value) else nan
        lsb = 2.0 * pi / self.counts_per_revolution
        return floor(value / lsb + 0.5) * lsb
