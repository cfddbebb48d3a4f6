"""The default experiment of an FMU or a system: its times and tolerance."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DefaultExperiment:
    """Default times in seconds and the default relative tolerance; None where the description says nothing."""

    start_time: float | None = None
    stop_time: float | None = None
    step_size: float | None = None
    tolerance: float | None = None
