"""Whether samples belong to the inputs of their own row, where the observer takes those of the row before.

A logger that takes all channels at one instant writes an output with feed-through, as the voltage of a battery, beside
the input that it belongs to. The observer holds an input from its row on, so that this one acts after the sample.
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.log.online import Stretch
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations, Vector

# So many rows without feed-through are those of a plant that has none.
_TRIED = 50
# Rows that tell, at least, and the part of the squared residuals that is left with the inputs of the own row.
_LEAST_ROWS, _LEFT = 10, 0.25


class OwnInput:
    """Counts over the rows of a log, stretch by stretch, for a plant with parameters p."""

    def __init__(self, eq: Equations, p: Vector) -> None:
        self._eq, self._p = eq, p
        self._may_be = eq.matrices is None and eq.channel is None
        self._last: Array | None = None
        self._rows, self._as_taken, self._with_own = np.zeros((3, len(eq.outputs)))

    def add(self, stretch: Stretch, x: Array) -> None:
        """Count a stretch, for which the observer predicted the states x (K,n), behind those before it."""
        if not self._may_be:
            return
        inputs, online = stretch.log.inputs, stretch.online
        before = np.concatenate([inputs[:1] if self._last is None else self._last, inputs[:-1]])
        self._last = inputs[-1:]
        effect = np.zeros(online.residual.shape)
        for count, k in enumerate(np.flatnonzero((inputs != before).any(axis=1)).tolist()):
            own, taken = (self._output(x[k].tolist(), u[k].tolist()) for u in (inputs, before))
            effect[k] = own - taken
            if count == _TRIED and not effect.any():
                self._may_be = False
                return
        tells = np.abs(effect) > online.residual_std  # false where nothing was measured
        e = np.where(tells, online.residual, 0.0)
        self._rows += tells.sum(axis=0)
        self._as_taken += (e**2).sum(axis=0)
        self._with_own += ((e - np.where(tells, effect, 0.0)) ** 2).sum(axis=0)

    def warnings(self) -> list[str]:
        """Return a line for each output whose samples belong to the inputs of their own rows."""
        found = (self._rows >= _LEAST_ROWS) & (self._with_own < _LEFT * self._as_taken)
        return [
            f"{name} follows the inputs of its own row, where those of the row before are taken, as all were measured "
            "at one time: write each input into the row before (docs/logs.md)"
            for name, is_own in zip(self._eq.outputs, found.tolist(), strict=True)
            if is_own
        ]

    def _output(self, x: Vector, u: Vector) -> Array:
        return np.array(self._eq.output(x, u, self._p), dtype=float)
