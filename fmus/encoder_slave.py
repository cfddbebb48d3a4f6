"""`Encoder`: what a sampled, quantised, delayed and sometimes lost measurement makes of an angle."""

from __future__ import annotations

from fmus.slave_sampling import SamplingSlave
from ndob_fmu.runtime.blocks.encoder import Encoder, angle_of_a_count
from ndob_fmu.runtime.blocks.sampled_measurement import Sampling


class EncoderSlave(SamplingSlave):
    """Takes the sample that is due at the end of a step, and shows those whose delay is over."""

    measured = "angle"

    def resolution(self) -> float:
        """Return the angle of one count."""
        return angle_of_a_count(self.value("counts_per_revolution"))

    def make(self, sampling: Sampling) -> Encoder:
        """Make the encoder."""
        return Encoder(sampling)
