"""Samples that arrive late: what a delayed sensor measured in the past is kept as a state, which the sample corrects.

At each sample the outputs of delayed sensors, as the estimate has them, become entries behind ξ. A sample of age τ
measures the line between the entries before and after t − τ. An input that is held bends the motion at each sample, so
that a parabola through more entries would be worse.
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector

# Instants that are kept of the longest delay. Where it has more samples, not every one is kept.
_KEPT = 16
PLACES = _KEPT + 3


def row_in_past(age: Array, tau: float, now: Array, which: int, count: int) -> Array | None:
    """Return the row (rows,) of a sample of age τ (s); None where the past does not reach so far.

    age (K,): of the instants that are kept, the oldest first; −1 for an empty place
    now (rows,): the row of the output at this sample
    which, count: the place of the sensor among `count` delayed ones
    """
    N = len(now) - len(age) * count
    slots = [slot for slot, a in enumerate(age.tolist()) if a >= 0.0]
    ages = [*age[slots].tolist(), 0.0]
    older = -1
    for i, a in enumerate(ages):
        if a >= tau * (1.0 - 1e-9):
            older = i
    if older < 0:
        return None
    last = len(ages) - 1
    first = min(older, max(last - 1, 0))
    end = min(first + 2, last + 1)
    result = np.zeros(len(now))
    for i in range(first, end):
        weight = 1.0
        for j in range(first, end):
            if j != i:
                weight *= (tau - ages[j]) / (ages[i] - ages[j])
        if i == last:
            result += weight * now
        else:
            result[N + slots[i] * count + which] += weight
    return result


def is_kept(age: Array, longest: float) -> bool:
    """Return whether this sample is far enough from the last instant that is kept, for the longest delay (s)."""
    newest = float(age[-1])
    return not 0.0 <= newest < (1.0 - 1e-9) * longest / _KEPT


def delayed(delay: Vector) -> tuple[int, ...]:
    """Return the indices of the outputs that arrive late."""
    return tuple(i for i, tau in enumerate(delay) if tau > 0.0)
