"""What a log tells of a number."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Told:
    """A number that a log tells, and its standard deviation in the same unit."""

    value: float
    std: float
