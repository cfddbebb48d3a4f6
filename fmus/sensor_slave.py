"""`Sensor`: a sampled, quantised, delayed and sometimes lost measurement of any quantity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fmus.slave_sampling import SamplingSlave
from ndob_fmu.runtime.blocks.sensor import Sensor


class SensorSlave(SamplingSlave):
    """Shows the last sample whose delay is over at the end of a step."""

    measured = "value"

    def make(self, parameters: Mapping[str, Any]) -> Sensor:
        """Make the sensor."""
        return Sensor(resolution=self.value("resolution"), **parameters)
