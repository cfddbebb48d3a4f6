"""The columns that a row of results has besides parameters and measures."""

from __future__ import annotations

RUN, FAILED, REASON, WALL_TIME, TIME = "run", "failed", "reason", "wall_time", "time"
ENDED_AT = "ended_at"  # s, of a run that an FMU ended before its stop time
RESERVED = (RUN, FAILED, REASON, ENDED_AT, WALL_TIME, TIME)


def over_time(signal: str) -> str:
    """Return the column with a recorded signal's values over time."""
    return f"{signal}(t)"
