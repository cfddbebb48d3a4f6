"""Base of the slaves of sampling devices: one input, and as outputs its sample and whether that is a new one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

from fmus.slave_base import Slave
from ndob_fmu.runtime.blocks.encoder import Encoder
from ndob_fmu.runtime.blocks.sampled_measurement import MISSING, SampledState, Sampling
from ndob_fmu.runtime.blocks.sensor import Sensor

_PARAMETERS = ("noise_std", "bias", "seed", "sample_time", "delay", "dropout_probability")


class SamplingSlave(Slave):
    """Hands over the value that is set before a step as that at its end; a subclass makes the device."""

    state_types = (SampledState,)
    state: SampledState
    measured: ClassVar[str]
    """The name of the input."""

    @abstractmethod
    def resolution(self) -> float:
        """Return the number of which a sample is a multiple; 0 where samples are not rounded."""

    @abstractmethod
    def make(self, sampling: Sampling) -> Sensor | Encoder:
        """Return the device."""

    def start(self, start_time: float) -> None:
        """Make the device from the parameters."""
        nan_shown = {
            name: self.value(rule) == MISSING["not_a_number"]
            for name, rule in (("between_samples_nan", "between_samples"), ("dropped_nan", "dropped_sample"))
        }
        shared = dict(zip(_PARAMETERS, self.values(_PARAMETERS), strict=True))
        self.device = self.make(Sampling(**shared, **nan_shown, resolution=self.resolution()))
        self.state = self.device.init(self.value(self.measured), start_time)

    def possible(self, state: SampledState, begin: float, now: float) -> bool:
        """Whether the device can be in such a state now."""
        numbers = all(type(number) is float for number in (*state.times, *state.values))
        return numbers and state.start_time == begin and self.device.possible(state, now)

    def show(self) -> Sequence[Any]:
        """Return the first sample, of the value set so far."""
        self.state = self.device.init(self.value(self.measured), self.state.start_time)
        return [self.state.shown, self.state.new]

    def advance(self, t: float, step_size: float) -> Sequence[Any]:
        """Go to the end of the step."""
        self.state = self.device.step(self.state, self.value(self.measured), t + step_size, step_size)
        return [self.state.shown, self.state.new]
