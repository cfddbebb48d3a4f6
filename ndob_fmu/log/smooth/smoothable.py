"""Which logs can be smoothed: what there is no smoothed estimate for, and the commands that need one."""

from __future__ import annotations

from typing import NamedTuple

from ndob_fmu.errors import UsageError
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.step.sampled_observer import SampledObserver


class NotSmoothed(NamedTuple):
    """Why there is no smoothed estimate, and what to do about it, where something can be done."""

    reason: str
    remedy: str


def not_smoothed(eq: Equations, observer: SampledObserver) -> NotSmoothed | None:
    """Return why an observer's log has no smoothed estimate, None where it has one.

    With order 0 the disturbance has no model. Late samples, and a disturbance behind a channel that depends on the
    state, are not in the linear record.
    """
    if eq.channel is not None:
        return NotSmoothed("a channel", "")
    late = [name for name, delay in zip(eq.outputs, observer.settings.sensors.delay, strict=True) if delay > 0.0]
    if late:
        return NotSmoothed(f"{late[0]}_delay", "move the column in the log by its delay")
    if observer.layout.order == 0:
        return NotSmoothed("disturbance_order 0", "--start-values disturbance_order 1")
    return None


def check_smoothed(command: str, eq: Equations, observer: SampledObserver) -> None:
    """Raise UsageError for a command where there is no smoothed estimate."""
    found = not_smoothed(eq, observer)
    if found is not None:
        raise UsageError.report(
            command,
            expected="a plant without a channel, outputs without a delay, and disturbance_order 1 or more",
            received=found.reason,
            likely=found.remedy,
        )
