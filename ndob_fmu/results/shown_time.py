"""The time as people read it: that of a clock which starts far from 0 counts from the first row on."""

from __future__ import annotations

from dataclasses import dataclass

from ndob_fmu.runtime.arrays import Array

# So many steps from 0, two rows have the same six digits.
_FAR = 1e5


@dataclass(frozen=True)
class ShownTime:
    """Times of a record, less the time `zero` (s) that is shown as 0."""

    zero: float = 0.0

    def of(self, time: Array) -> Array:
        """Return times (rows,) as they are shown."""
        return time - self.zero

    @property
    def text(self) -> str:
        """What a time of 0 is, to follow a span of times; empty where the record's own times are shown."""
        return f"times from the first row, at {seconds(self.zero)} s" if self.zero else ""

    @property
    def label(self) -> str:
        """The label of an axis."""
        return f"time [s] from the first row, at {seconds(self.zero)} s" if self.zero else "time [s]"


def shown_time(start: float, step: float) -> ShownTime:
    """Return how the times of a record are shown that starts at a time (s), with steps of so many s."""
    return ShownTime(start if abs(start) > _FAR * step else 0.0)


def seconds(time: float) -> str:
    """Return a record's own time (s) with the digits that tell two rows apart, as it stands in the record."""
    return f"{time:.13g}"
