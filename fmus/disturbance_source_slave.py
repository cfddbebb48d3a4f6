"""`DisturbanceSource`: a disturbance as a function of time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fmus.slave_base import Slave
from ndob_fmu.runtime.blocks.disturbance_source import Signal, disturbance_source
from ndob_fmu.runtime.times import same_time


class DisturbanceSourceSlave(Slave):
    """Shows the disturbance at the end of each step; it remembers the time only."""

    state: float

    def start(self, start_time: float) -> None:
        """Make the signal from the parameters."""
        names = ("kind", "amplitude", "frequency", "start_time", "seed", "profile", "interpolation")
        kind, *options = self.values(f"disturbance.{name}" for name in names)
        self.signal: Signal = disturbance_source(kind, **dict(zip(names[1:], options, strict=True)))
        self.state = start_time

    def possible(self, state: float, begin: float, now: float) -> bool:
        """Whether the time remembered is the present one."""
        return same_time(state, now)

    def show(self) -> Sequence[Any]:
        """Return the disturbance at the start."""
        return [self.signal(self.state)]

    def advance(self, t: float, step_size: float) -> Sequence[Any]:
        """Return the disturbance at the end of the step."""
        self.state = t + step_size
        return [self.signal(self.state)]
