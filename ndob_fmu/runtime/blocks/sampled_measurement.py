"""What sampling devices share: the errors of a sample, when it is due, and what is shown where one is missing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import floor, isfinite, nan, ulp

from ndob_fmu.runtime.blocks.random_numbers import normal, uniforms

MISSING = {"held": 1, "not_a_number": 2}

# Hosts add up their times, or round them. A sample or a value that is due within this part of a period or of a step
# after the step's end, or within this many roundings of its time, must not slip to the next step.
_OF_A_PERIOD, _OF_A_STEP, _ROUNDINGS = 1e-6, 1e-3, 4.0
_LARGEST_INDEX = 2**53  # the largest number up to which a float counts


@dataclass(frozen=True)
class SampledState:
    """What a sampling device remembers between two steps.

    start_time: s, of the first sample
    index: of the last sample
    points: pairs of a time (s) and a value, in ascending order of time; the device says which ones it keeps
    good: the last good sample that was shown
    shown: what is shown now
    new: whether that is a sample that was not shown before
    """

    start_time: float
    index: int
    points: tuple[tuple[float, float], ...] = field(metadata={"grows": True})
    good: float
    shown: float
    new: bool


@dataclass(frozen=True)
class SampledMeasurement(ABC):
    """A sampling device: `init` returns its state at the start, `step` that at the end of a step.

    Values are in the unit of the measured quantity, times in s. A sample is value + bias + noise, rounded to a multiple
    of the device's resolution. The first sample, taken at t₀, is never lost and shown at once.

    noise_std: standard deviation of the noise, which `seed` and the index of a sample determine
    bias: added to the value before rounding
    sample_time: between samples; 0: one sample for each step
    delay: time after which a sample is shown
    dropout_probability: of losing a sample; one that is not finite is lost as well
    between_samples_nan: whether NaN is shown where no sample is due; otherwise the last good sample
    dropped_nan: whether NaN is shown for a lost sample; otherwise the last good sample
    """

    noise_std: float
    bias: float
    seed: int
    sample_time: float
    delay: float
    dropout_probability: float
    between_samples_nan: bool
    dropped_nan: bool

    @abstractmethod
    def rounded_to(self) -> float:
        """Return the number of which a sample is a multiple; 0 where samples are not rounded."""

    @abstractmethod
    def step(self, state: SampledState, value: float, t_end: float, step_size: float) -> SampledState:
        """Take the value at the end of the step, and show what is due then."""

    @abstractmethod
    def possible_points(self, state: SampledState, t: float) -> bool:
        """Return whether a device can have such points, whose times ascend, at the time t (s)."""

    def init(self, value: float, t: float) -> SampledState:
        """Return the state that shows the first sample, of the value at t."""
        first = self._measured(value, 0)
        return SampledState(start_time=t, index=0, points=(), good=first, shown=first, new=isfinite(first))

    def possible(self, state: SampledState, t: float) -> bool:
        """Return whether numbers in the form of a state can be one at the time t (s)."""
        if not all(isinstance(point, tuple) and [*map(type, point)] == [float, float] for point in state.points):
            return False
        times = [time for time, _ in state.points]
        ascending = times == sorted(times) and all(map(isfinite, times))
        in_range = 0 <= state.index <= _LARGEST_INDEX and isfinite(state.start_time)
        return ascending and in_range and self.possible_points(state, t)

    def _sample(self, value: float, index: int) -> float:
        """Return the sample of this index, NaN if it is lost."""
        lost = uniforms(self.seed, index)[2] < self.dropout_probability
        return nan if lost else self._measured(value, index)

    def _measured(self, value: float, index: int) -> float:
        first, second, *_ = uniforms(self.seed, index)
        disturbed = value + self.bias + self.noise_std * normal(first, second)
        quantum = self.rounded_to()
        if not isfinite(disturbed):
            return nan
        # Beyond 2⁵³ counts the numbers themselves are coarser than the quantum.
        if quantum == 0.0 or abs(disturbed / quantum) >= _LARGEST_INDEX:
            return disturbed
        return floor(disturbed / quantum + 0.5) * quantum

    def _shown(self, good: float, samples: Iterable[float]) -> tuple[float, float, bool]:
        """Return `good`, `shown` and `new` of the next state.

        good: the last good sample before; samples: those that are due in this step, in order, NaN for a lost one.
        """
        shown, new = nan if self.between_samples_nan else good, False
        for value in samples:
            new = isfinite(value)
            good = value if new else good
            shown = value if new or self.dropped_nan else good
        return good, shown, new

    def _latest_index(self, since_start: float, slack: float) -> int:
        """Return the index of the last sample that is due; only with a sample_time > 0.

        since_start: s since the first sample; slack: s that a sample may be late by, see `_slack`.
        """
        return floor((since_start + max(slack, _OF_A_PERIOD * self.sample_time)) / self.sample_time)

    @staticmethod
    def _slack(t_end: float, step_size: float) -> float:
        """Return by how much (s) a time may lie after the end of a step and still belong to the step."""
        return max(_OF_A_STEP * step_size, _ROUNDINGS * ulp(t_end))
