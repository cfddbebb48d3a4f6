"""The table of an estimated log: what the FMU would have shown at each row, and the smoothed estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ndob_fmu.interface.model_variables import observer_variables
from ndob_fmu.log.online import Online, Stretch
from ndob_fmu.log.smooth.c_library import c_library
from ndob_fmu.log.smooth.smooth_log import SmoothedStretch
from ndob_fmu.results.csv_files import csv_lines
from ndob_fmu.results.recording import Recording
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.step.observer import Estimate

LOG, OBSERVER, SMOOTHER = "log", "observer", "smoother"


class ResultTable:
    """Makes the rows of the table, stretch by stretch: `log.` inputs and samples, `observer.` the FMU's outputs.

    A row of the observer has the values that are valid at its time, as in a simulation: those of the step that ends
    there. `smoother.` has the smoothed estimate for the row's time.
    """

    def __init__(self, equations: Equations, before: Estimate, biased: Sequence[str], *, smooths: bool) -> None:
        """Begin the table; `biased`: outputs that have an unknown offset."""
        self._shown = np.concatenate([np.atleast_1d(np.asarray(part, dtype=float)) for part in _published(before)])
        outputs = [v for v in observer_variables(equations) if v.causality == "output"]
        signals = [*equations.inputs, *equations.outputs]
        own = {name: name for name in (*equations.states, *equations.disturbances)}
        own |= {f"{name}_bias": name for name in biased}
        estimated = [*own] if smooths else []
        stds = [f"{name}_std" for name in estimated]
        self._names = (
            *(f"{LOG}.{name}" for name in signals),
            *(f"{OBSERVER}.{variable.name}" for variable in outputs),
            *(f"{SMOOTHER}.{name}" for name in (*estimated, *stds)),
        )
        self._types = tuple("Boolean" if name == f"{OBSERVER}.valid" else "Real" for name in self._names)
        units = dict(equations.units)
        found = {f"{LOG}.{name}": units.get(name, "") for name in signals}
        found |= {f"{OBSERVER}.{variable.name}": variable.unit for variable in outputs}
        for names in (estimated, stds):
            found |= {f"{SMOOTHER}.{name}": units.get(own[of], "") for name, of in zip(names, estimated, strict=True)}
        self.units: Mapping[str, str] = {name: unit for name, unit in found.items() if unit}

    def rows(self, stretch: Stretch, smoothed: SmoothedStretch | None) -> Recording:
        """Return the rows of the next stretch."""
        ended = np.column_stack(_published(stretch.online))
        shown = np.concatenate([self._shown[None], ended[:-1]])
        self._shown = ended[-1]
        parts = [stretch.log.inputs, stretch.log.outputs, shown]
        if smoothed is not None:
            parts += [smoothed.x, smoothed.d, smoothed.offset, smoothed.x_std, smoothed.d_std, smoothed.offset_std]
        return Recording(stretch.log.time, self._names, np.hstack(parts), self._types, self.units)


def table_lines(rows: Array, whole: Sequence[int]) -> str:
    """Return `csv_lines` of rows."""
    in_c = c_library(len(rows))
    return csv_lines(rows, whole) if in_c is None else in_c.lines(rows, whole)


def _published(said: Online | Estimate) -> Sequence[Array | Sequence[float] | float]:
    """Return what the FMU shows, in the order of its outputs."""
    return (
        said.x_hat,
        said.d_hat,
        said.d_at_sample,
        said.d_std,
        said.d_lagged,
        said.d_lagged_std,
        said.residual,
        said.residual_std,
        said.valid,
        said.consistency,
    )
