"""The columns that a row of results has besides parameters and measures."""

from __future__ import annotations

RUN, FAILED, REASON, WALL_TIME, TIME = "run", "failed", "reason", "wall_time", "time"
RESERVED = (RUN, FAILED, REASON, WALL_TIME, TIME)


def over_time(signal: str) -> str:
    """Return the column with a recorded signal's values over time."""
    return f"{signal}(t)"
