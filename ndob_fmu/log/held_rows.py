"""In how many rows of a log dry friction holds the plant, as the observer sees it (`runtime.numerics.sliding`).

No sample tells of the disturbance there, so the user should know how many rows that are.
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.log.online import Stretch
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.numerics.sliding import sliding

# So many rows of a stretch tell its share. Less than this share of all rows is not worth a warning.
_ROWS, _SHARE = 1000, 0.02


class HeldRows:
    """Counts over the rows of a log, stretch by stretch, for a plant with parameters p."""

    def __init__(self, eq: Equations, p: Vector) -> None:
        self._eq, self._p = eq, p
        self._rows, self._held = 0.0, 0.0

    def add(self, stretch: Stretch, x: Array) -> None:
        """Count a stretch, for which the observer predicted the states x (K,n)."""
        if self._eq.surfaces is None:
            return
        looked_at = np.unique(np.linspace(0, len(x) - 1, _ROWS).astype(int))
        held = sum(
            self._is_held(x[k], stretch.log.inputs[k], stretch.online.d_at_sample[k]) for k in looked_at.tolist()
        )
        self._rows += len(x)
        self._held += len(x) * held / len(looked_at)

    def warnings(self) -> list[str]:
        """Return a line where friction holds the plant in a part of the rows."""
        if self._held <= _SHARE * self._rows:
            return []
        return [
            f"friction holds the plant in {100.0 * self._held / self._rows:.0f} % of the rows: no sample tells of the "
            "disturbance there; the error bars say so, and a fit leaves these rows out (docs/models.md)"
        ]

    def _is_held(self, x: Array, u: Array, d: Array) -> bool:
        inputs, disturbances = u.tolist(), d.tolist()

        def rate(x: Array) -> Array:
            return np.array(self._eq.derivatives(x.tolist(), inputs, disturbances, self._p), dtype=float)

        def surfaces(x: Array) -> Array:
            return self._eq.surfaces_at(x.tolist(), inputs, self._p)

        here = sliding(rate, surfaces, x)
        return here is not None and len(here.held) > 0
