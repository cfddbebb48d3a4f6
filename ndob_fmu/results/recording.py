"""The recorded signals of a run as a value, and the error of a run that failed with what it had recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.errors import SimulationError, UsageError, nearest, one_of

_DTYPES = {"Integer": np.dtype(np.int64), "Enumeration": np.dtype(np.int64), "Boolean": np.dtype(np.bool_)}


@dataclass(frozen=True, eq=False)
class Recording:
    """Signals over time: row k of every array belongs to ``time[k]``.

    time: (rows,) in seconds.
    names: of the columns, ``component.variable``.
    columns: (rows, len(names)), all as floats.
    types: the FMI type of each column; empty means that all are Real.
    units: by name, of the columns that have one.
    ended_early: which component ended the run before its stop time, when and why; empty if none did.

    Raises UsageError if the shapes contradict one another.
    """

    time: NDArray[np.float64]
    names: tuple[str, ...]
    columns: NDArray[np.float64]
    types: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    ended_early: str = ""
    _position: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        expected = (*self.time.shape, len(self.names))
        if self.time.ndim != 1 or self.columns.shape != expected or len(self.types) not in (0, len(self.names)):
            raise UsageError.report(
                "recording",
                expected=f"time (rows,), columns {expected} and one type per column or none",
                received=f"time {self.time.shape}, columns {self.columns.shape} and {len(self.types)} types",
            )
        object.__setattr__(self, "types", self.types or ("Real",) * len(self.names))
        object.__setattr__(self, "_position", {name: column for column, name in enumerate(self.names)})

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return one signal, (rows,), as float64, int64 or bool after its FMI type; raise UsageError if absent."""
        if name not in self._position:
            raise UsageError.report(
                "recording",
                expected=one_of("signal", self.names, name),
                received=repr(name),
                likely=nearest(name, self.names),
            )
        column = self._position[name]
        return self.columns[:, column].astype(_DTYPES.get(self.types[column], np.dtype(np.float64)))


class FailedRunError(SimulationError):
    """A component failed during a run; ``recording`` holds the rows before the failure, None where there are none."""

    def __init__(self, message: str, recording: Recording | None = None) -> None:
        super().__init__(message)
        self.recording = recording
