"""The samples of a log that a fit may use where dry friction holds the plant in a part of it (`smooth.held_steps`).

While a surface holds the state, samples tell neither the disturbance nor its pace, and those of an encoder show
no noise. So they do not count, and the disturbance may be any other one when the state is let go.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ndob_fmu.errors import UsageError
from ndob_fmu.log.smooth.along import Samples
from ndob_fmu.log.smooth.held_steps import held_at_first
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.runtime.arrays import Array

# Steps beside those in which the online estimate is held. It notices late that a plant moves, not that it stops.
_BESIDE = 5
# Rows that have to be left for a fit.
_LEAST_ROWS = 300


def while_moving(rows: RowModel, samples: Samples, trajectory: Array) -> Samples:
    """Return samples of a plant that moves, and NaN in place of the others; trajectory ξ (K,N): by the online estimate.

    Raises UsageError where too few rows are left.
    """
    if rows.model.equations.surfaces is None:
        return samples
    held = held_at_first(rows, trajectory, samples.inputs, passing=False)
    if not held.any.any():
        return samples
    held = held.widened(_BESIDE).letting_go_of_jumps()
    still = np.append(held.any, held.any[-1])
    still[1:] &= held.any
    if np.count_nonzero(~still) < _LEAST_ROWS:
        raise UsageError.report(
            "fit",
            expected=f"at least {_LEAST_ROWS} rows in which the plant moves",
            received=str(np.count_nonzero(~still)),
            likely="friction holds it in the others, where samples tell nothing",
        )
    return replace(samples, outputs=np.where(still[:, None], np.nan, samples.outputs), held=held)
