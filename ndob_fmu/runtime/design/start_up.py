"""Where the sampled-data observer starts: the covariance before the first sample, and how long the start lasts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.augmented import Augmented
from ndob_fmu.runtime.design.tuning import Knowledge

_SAMPLES_PER_STATE = 3


@dataclass(frozen=True)
class StartUp:
    """The start of the covariance recursion.

    factor (N,N): of the covariance before the first sample.
    samples: how many samples the start lasts; the gain is not frozen before.
    """

    factor: Array = field(repr=False)
    samples: int


def start_up(system: Augmented, known: Knowledge, x_std: Array) -> StartUp:
    """Return the start from x̂₀ with errors of the standard deviations x_std (n,), and a disturbance up to its bound.

    The derivatives of the disturbance below the r-th are bounded like those of a sine that has the amplitude D₀ and the
    r-th derivative D_r.
    """
    r, bound = system.order, known.disturbance_bound
    pace = (known.disturbance_rate / bound) ** (1.0 / max(r, 1))
    factor = np.diag(np.concatenate([x_std, *(bound * pace**i for i in range(r))]))
    return StartUp(factor=factor, samples=_SAMPLES_PER_STATE * len(system.A))
