"""A recorded log, or a block of its rows, as a value: time stamps, inputs and samples."""

from __future__ import annotations

from dataclasses import dataclass

from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True)
class Found:
    """What was irregular in the rows of a file, and how many times.

    rows: of the file
    merged: rows with the time of the row before, whose samples were added to it
    missing_inputs: entries of inputs that were held from the row before
    missing_samples: entries of outputs that were not measured
    """

    rows: int = 0
    merged: int = 0
    missing_inputs: int = 0
    missing_samples: int = 0

    def __add__(self, other: Found) -> Found:
        """Return the counts of both."""
        return Found(
            self.rows + other.rows,
            self.merged + other.merged,
            self.missing_inputs + other.missing_inputs,
            self.missing_samples + other.missing_samples,
        )


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
