"""The disturbance_rate for which the observer tunes itself to a given intensity."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ndob_fmu.errors import DesignError
from ndob_fmu.runtime.arrays import Array

# The intensity grows with the rate by a power of 1 to 2 (`design.intensity_law`).
_FIRST_POWER, _LEAST_POWER, _MOST_POWER = 1.8, 0.5, 4.0
_MOST_TRIALS = 12
# A difference of the intensity that no estimate shows.
_CLOSE = 0.05
_FARTHEST = 5.0  # of one trial from the next, in powers of e


def rates_for(intensity: Array, tuned: Callable[[Array], Array], rates: Array) -> Array:
    """Return rates (q2,) for which tuned(rates) is an intensity (q2,); `rates`: where to begin.

    The nearest ones where the tuning ends before.
    """
    at, power = np.log(rates), np.full(len(rates), _FIRST_POWER)
    wanted, best, least = np.log(intensity), at, np.inf
    before: tuple[Array, Array] | None = None
    for _ in range(_MOST_TRIALS):
        try:
            missing = wanted - np.log(tuned(np.exp(at)))
        except DesignError:  # too fast or too slow for the samples
            if before is None:
                raise
            at = 0.5 * (at + before[0])
            continue
        worst = float(np.max(np.abs(missing)))
        if worst < least:
            best, least = at, worst
        if worst < _CLOSE:
            break
        if before is not None:
            moved = at - before[0]
            with np.errstate(all="ignore"):
                power = np.where(np.abs(moved) > 1e-6, (before[1] - missing) / moved, power)
            power = np.clip(np.nan_to_num(power, nan=_FIRST_POWER), _LEAST_POWER, _MOST_POWER)
        before = (at, missing)
        at = at + np.clip(missing / power, -_FARTHEST, _FARTHEST)
    return np.asarray(np.exp(best))
