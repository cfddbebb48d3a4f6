"""What a system description says about how long and how finely to simulate."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DefaultExperiment:
    """Default times in seconds and the default relative tolerance; None where the description says nothing."""

    start_time: float | None = None
    stop_time: float | None = None
    step_size: float | None = None
    tolerance: float | None = None
