"""`Encoder`: what a sampled, quantised, delayed and sometimes lost measurement makes of an angle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fmus.slave_sampling import SamplingSlave
from ndob_fmu.runtime.blocks.encoder import Encoder


class EncoderSlave(SamplingSlave):
    """Takes the sample that is due at the end of a step, and shows those whose delay is over."""

    measured = "angle"

    def make(self, parameters: Mapping[str, Any]) -> Encoder:
        """Make the encoder."""
        return Encoder(counts_per_revolution=self.value("counts_per_revolution"), **parameters)
