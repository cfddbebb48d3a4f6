"""What sampling devices share: the errors of a sample, when it is due, and what is shown where one is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import floor, isfinite, isinf, nan, ulp

from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.blocks.random_numbers import normal, uniforms

MISSING = {"held": 1, "not_a_number": 2}

# Hosts add up their times, or round them. A sample or a value that is due within this part of a period or of a step
# after the step's end, or within this many roundings of its time, must not slip to the next step.
_OF_A_PERIOD, _OF_A_STEP, _ROUNDINGS = 1e-6, 1e-3, 4.0
_LARGEST_INDEX = 2.0**53  # the largest number up to which a float counts


@dataclass(frozen=True)
class SampledState:
    """What a sampling device remembers between two steps.

    start_time: s, of the first sample
    index: of the last sample, an integer
    times, values: pairs of a time (s) and a value, in ascending order of time; the device says which ones it keeps
    good: the last good sample that was shown
    shown: what is shown now
    new: whether that is a sample that was not shown before
    """

    start_time: float
    index: float
    times: tuple[float, ...] = field(metadata={"grows": True})
    values: tuple[float, ...] = field(metadata={"grows": True})
    good: float
    shown: float
    new: bool


@dataclass(frozen=True)
class Sampling:
    """How samples are taken, and what is wrong with them.

    Values are in the unit of the measured quantity, times in s. A sample is value + bias + noise, rounded to a multiple
    of the resolution. The first sample, taken at t₀, is never lost and shown at once.

    noise_std: standard deviation of the noise, which `seed` and the index of a sample determine
    bias: added to the value before rounding
    sample_time: between samples; 0: one sample for each step
    delay: time after which a sample is shown
    dropout_probability: of losing a sample; one that is not finite is lost as well
    between_samples_nan: whether NaN is shown where no sample is due; otherwise the last good sample
    dropped_nan: whether NaN is shown for a lost sample; otherwise the last good sample
    resolution: a sample is a multiple of it; 0: not rounded
    """

    noise_std: float
    bias: float
    seed: int
    sample_time: float
    delay: float
    dropout_probability: float
    between_samples_nan: bool
    dropped_nan: bool
    resolution: float

    def start(self, value: float, t: float) -> SampledState:
        """Return the state that shows the first sample, of the value at t."""
        first = self._measured(value, 0.0)
        return SampledState(start_time=t, index=0.0, times=(), values=(), good=first, shown=first, new=isfinite(first))

    def sample(self, value: float, index: float) -> float:
        """Return the sample of this index, NaN if it is lost."""
        if uniforms(self.seed, index)[2] < self.dropout_probability:
            return nan
        return self._measured(value, index)

    def shown(self, good: float, samples: Sequence[float]) -> tuple[float, float, bool]:
        """Return `good`, `shown` and `new` of the next state.

        good: the last good sample before; samples: those that are due in this step, in order, NaN for a lost one.
        """
        shown, new = nan if self.between_samples_nan else good, False
        for value in samples:
            new = isfinite(value)
            good = value if new else good
            shown = value if new or self.dropped_nan else good
        return good, shown, new

    def latest_index(self, since_start: float, slack: float) -> float:
        """Return the index of the last sample that is due; only with a sample_time > 0.

        since_start: s since the first sample; slack: s that a sample may be late by, see `slack_of`.

        Raises IntegrationError where more samples are due than a float counts.
        """
        periods = (since_start + max(slack, _OF_A_PERIOD * self.sample_time)) / self.sample_time
        if not periods <= _LARGEST_INDEX:
            raise IntegrationError.report(
                "sample_time",
                expected=f"at least {since_start / _LARGEST_INDEX:.3g} s, {since_start:g} s after the start",
                received=f"{self.sample_time:g} s",
            )
        return float(floor(periods))

    def _measured(self, value: float, index: float) -> float:
        drawn = uniforms(self.seed, index)
        disturbed = value + self.bias + self.noise_std * normal(drawn[0], drawn[1])
        if not isfinite(disturbed):
            return nan
        # Beyond 2⁵³ counts the numbers themselves are coarser than the resolution.
        if self.resolution == 0.0 or abs(disturbed / self.resolution) >= _LARGEST_INDEX:
            return disturbed
        return float(floor(disturbed / self.resolution + 0.5)) * self.resolution


def slack_of(t_end: float, step_size: float) -> float:
    """Return by how much (s) a time may lie after the end of a step and still belong to the step."""
    return max(_OF_A_STEP * step_size, _ROUNDINGS * ulp(t_end))


def is_possible(state: SampledState) -> bool:
    """Return whether numbers in the form of a state can be one; the device alone knows which times it can have."""
    times = state.times
    ascending = all(isfinite(time) for time in times) and all(first <= second for first, second in pairwise(times))
    in_range = 0.0 <= state.index <= _LARGEST_INDEX and state.index == float(floor(state.index))
    shows = not isinf(state.good) and not isinf(state.shown)
    return len(times) == len(state.values) and ascending and in_range and isfinite(state.start_time) and shows
