"""A recorded log, or a block of its rows, as a value: time stamps, inputs and samples."""

from __future__ import annotations

from dataclasses import dataclass, fields

from ndob_fmu.runtime.arrays import Array

_OVERWRITTEN = 0.01  # of the rows: single ones are a logger's repetitions


@dataclass(frozen=True)
class Found:
    """What was irregular in the rows of a file, and how many times.

    rows: of the file
    merged: rows with the time of the row before, whose samples were added to it
    overwritten: merged rows with another sample of an output that the row before has, too
    missing_inputs: entries of inputs that were held from the row before
    missing_samples: entries of outputs that were not measured
    """

    rows: int = 0
    merged: int = 0
    overwritten: int = 0
    missing_inputs: int = 0
    missing_samples: int = 0

    def __add__(self, other: Found) -> Found:
        """Return the counts of both."""
        return Found(*(getattr(self, one.name) + getattr(other, one.name) for one in fields(Found)))

    @property
    def warnings(self) -> list[str]:
        """What in the rows cannot be meant so, one line each."""
        if self.overwritten <= _OVERWRITTEN * self.rows:
            return []
        return [
            f"{self.overwritten} of {self.rows} rows have the time of the row before and other samples, of which only "
            "the last ones count: the times have too few digits, or the file holds several logs"
        ]


@dataclass(frozen=True)
class Log:
    """Rows of a log, in the units of the model.

    time (K,): in s, increasing
    inputs (K,m): each is held until the next row
    outputs (K,p): samples; NaN where nothing was measured
    found: what was irregular
    """

    time: Array
    inputs: Array
    outputs: Array
    found: Found
