"""`TorsionSpring`: pulls two angles together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fmus.slave_base import Slave
from ndob_fmu.runtime.blocks.torsion_spring import spring_torques


class TorsionSpringSlave(Slave):
    """Shows the torques for the angles that a step begins with; it remembers nothing."""

    def start(self, start_time: float) -> None:
        """There is nothing to make."""

    def show(self) -> Sequence[Any]:
        """Return the torques for the angles set so far."""
        return spring_torques(*self.values(("stiffness", "angle_a", "angle_b")))

    def advance(self, t: float, step_size: float) -> Sequence[Any]:
        """Return the torques for the angles at the start of the step."""
        return self.show()
