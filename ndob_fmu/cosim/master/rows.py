"""The rows of a run, also of one that ends before its stop time or fails."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from ndob_fmu.cosim.master.schemes import Ending
from ndob_fmu.cosim.time_grid import TimeGrid
from ndob_fmu.errors import NdobError, SimulationError, UsageError
from ndob_fmu.results.recording import FailedRunError, Recording
from ndob_fmu.runtime.arrays import Array


class Rows:
    """The rows recorded so far, in memory for all of them."""

    def __init__(self, names: Sequence[str], types: Sequence[str], grid: TimeGrid) -> None:
        """Make room for the whole run; raise UsageError if it does not fit in memory."""
        self._names, self._types, self._grid = tuple(names), tuple(types), grid
        self._time, self._columns = _allocate(grid, len(names))
        self._count = 0
        self._ended_early = ""

    def take(self, values: Array) -> None:
        """Record the values at the next point, (width,)."""
        self._columns[self._count] = values
        self._count += 1

    @property
    def last(self) -> Array:
        """The values recorded last, (width,)."""
        values: Array = self._columns[self._count - 1]
        return values

    def end(self, ending: Ending, values: Array, done: int) -> None:
        """Make the time of ``ending`` that of the last row; values: (width,), those after ``done`` steps.

        Rows after that time are dropped: with gauss-seidel a component that makes longer steps may end the simulation
        at a time that the others have passed.
        """
        part, ended = ending.part, ending.ended
        self._count = min(self._count, ending.steps // self._grid.stride + 1)
        last = self._count - 1
        row = (values if done <= ending.steps else self._columns[last]).copy()
        self._ended_early = f"component {part.name} ended the simulation at t = {ended.time:.12g} s"
        self._ended_early += f": {ended.reason}" if ended.reason else ""
        try:
            part.send()
        except SimulationError:  # an FMU that has ended need not return values; the rows before stay
            return
        row[part.place] = part.outputs
        if ending.steps > last * self._grid.stride or not self._grid.is_point(ended.time):
            last += 1
            self._time[last] = ended.time
        self._columns[last] = row
        self._count = last + 1

    def recording(self) -> Recording:
        """Return what has been recorded."""
        time, columns = self._time[: self._count], self._columns[: self._count]
        return Recording(time, self._names, columns, self._types, ended_early=self._ended_early)

    @contextmanager
    def kept_on_failure(self) -> Iterator[None]:
        """Raise a SimulationError of the block as a FailedRunError with the rows recorded before it, if any."""
        try:
            yield
        except SimulationError as error:
            raise FailedRunError(str(error), self.recording() if self._count else None) from error


def _allocate(grid: TimeGrid, width: int) -> tuple[Array, Array]:
    rows = grid.steps // grid.stride + 2  # one more than recorded, for the time at which a component ends the run
    try:
        # The same expression as TimeGrid.time, so that the two agree to the last bit.
        time = np.float64(grid.start_time) + np.arange(rows) * grid.stride * grid.step_size
        return time, np.empty((rows, width))
    except (MemoryError, ValueError, OverflowError) as error:
        raise _too_long(rows, width) from error


def _too_long(rows: int, width: int) -> NdobError:
    return UsageError.report(
        "recording",
        expected="one that fits in memory",
        received=f"{rows} rows of {width} signals",
        likely="the step size is far too small; a larger output interval records less",
    )
