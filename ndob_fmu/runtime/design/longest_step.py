"""The longest communication step over which the sampled-data observer tries to predict."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.integrate import MOST_SUBSTEPS

_LARGEST_GROWTH = 700.0  # e^700 is nearly the largest number
_FAR = 1000.0
_STABLE = 4.0  # the integrator is stable for |λ| h below this


def longest_step(equations: Equations, linear: LinearPart) -> float:
    """Return the longest step (s) that is worth a try.

    Over a longer one errors could grow beyond the largest number, by the plant's fastest mode and ‖G_f‖ γ, or the
    integrator would need too many substeps. A declared γ may be far larger than the slopes of f where the plant works.
    So growth limits no step shorter than 1000 steps of the default experiment.
    """
    modes = np.linalg.eigvals(linear.A)
    growth = max(0.0, float(np.max(modes.real))) + linear.f_rate(equations.lipschitz)
    grown = max(_LARGEST_GROWTH / growth, _FAR * equations.experiment.step_size) if growth else np.inf
    fastest = float(np.max(np.abs(modes)))
    return min(grown, _STABLE * MOST_SUBSTEPS / fastest if fastest else np.inf)
