"""`Sensor`: a sampled, quantised, delayed and sometimes lost measurement of any quantity."""

from __future__ import annotations

from fmus.slave_sampling import SamplingSlave
from ndob_fmu.runtime.blocks.sampled_measurement import Sampling
from ndob_fmu.runtime.blocks.sensor import Sensor


class SensorSlave(SamplingSlave):
    """Shows the last sample whose delay is over at the end of a step."""

    measured = "value"

    def resolution(self) -> float:
        """Return the resolution."""
        return float(self.value("resolution"))

    def make(self, sampling: Sampling) -> Sensor:
        """Make the sensor."""
        return Sensor(sampling)
