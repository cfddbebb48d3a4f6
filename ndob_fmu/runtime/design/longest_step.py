"""The longest communication step over which the sampled-data observer tries to predict."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.linear_part import LinearPart

_LARGEST_GROWTH = 700.0  # e^700 is nearly the largest number
_FAR = 1000.0


def longest_step(equations: Equations, linear: LinearPart) -> float:
    """Return the longest step (s) that is worth a try.

    Over a longer one errors could grow beyond the largest number, by the plant's fastest unstable mode and ‖G_f‖ γ. A
    declared γ may be far larger than the slopes of f where the plant works. So growth limits no step shorter than 1000
    steps of the default experiment.
    """
    growth = max(0.0, float(np.max(np.linalg.eigvals(linear.A).real))) + linear.f_rate(equations.lipschitz)
    return max(_LARGEST_GROWTH / growth, _FAR * equations.experiment.step_size) if growth else np.inf
