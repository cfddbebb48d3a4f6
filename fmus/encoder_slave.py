"""`Encoder`: what a sampled, quantised, delayed and sometimes lost measurement makes of an angle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fmus.slave_base import Slave
from ndob_fmu.interface.component_variables import DESCRIPTIONS, EXPERIMENT, encoder_variables
from ndob_fmu.runtime.blocks.encoder import MISSING, Encoder, EncoderState


class EncoderSlave(Slave):
    """Takes the sample that is due at the end of a step, and shows those whose delay is over."""

    state_types = (EncoderState,)
    state: EncoderState

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(encoder_variables(), EXPERIMENT, DESCRIPTIONS["encoder"], **kwargs)

    def start(self, start_time: float) -> None:
        """Make the encoder from the parameters."""
        names = ("counts_per_revolution", "noise_std", "bias", "seed", "sample_time", "delay", "dropout_probability")
        between, dropped = self.values(("between_samples", "dropped_sample"))
        self.encoder = Encoder(
            **dict(zip(names, self.values(names), strict=True)),
            between_samples_nan=between == MISSING["not_a_number"],
            dropped_nan=dropped == MISSING["not_a_number"],
        )
        self.state = self.encoder.init(self.value("angle"), start_time)

    def possible(self, state: EncoderState, begin: float, now: float) -> bool:
        """Whether the encoder can be in such a state now."""
        return state.start_time == begin and self.encoder.possible(state, now)

    def show(self) -> Sequence[Any]:
        """Return the first sample, of the angle set so far."""
        self.state = self.encoder.init(self.value("angle"), self.state.start_time)
        return self._outputs()

    def advance(self, t: float, step_size: float) -> Sequence[Any]:
        """Go to the end of the step."""
        self.state = self.encoder.step(self.state, self.value("angle"), t + step_size, step_size)
        return self._outputs()

    def _outputs(self) -> list[Any]:
        return [self.state.shown, self.state.new]
