"""Outputs that the model cannot follow, as where a parameter is wrong that does not act as the disturbance does.

Innovations of a right model have E e² = α. Where they are larger as a rule, also with a disturbance that may do
anything, the error is the model's. Then R of that output is enlarged by what is left. Its samples no longer carry this
error into the disturbance, and are no longer taken for outliers by the dozen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ndob_fmu.log.smooth.events import Events, Jumps, with_events
from ndob_fmu.log.smooth.linear_record import Forward, LinearRecord
from ndob_fmu.log.smooth.whole_record import WholeRecord
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations

# Of the square of a normal number. A fourth of the rows shows what is a rule, so that jumps and outliers hardly count.
_LOWER_QUARTILE = 0.1015
# Squares that are less than this times as large as predicted are taken for right.
_RIGHT = 2.0
_MOST_PASSES = 4


def squared_sizes(run: Forward) -> Array:
    """Return how large the squared innovations of each output (p,) are over their variance, as a rule; 1 is right."""
    ratios = np.where(np.isfinite(run.alpha), run.innovation**2 / run.alpha, np.nan).T
    return np.array([np.nanquantile(one, 0.25) if np.isfinite(one).any() else 0.0 for one in ratios]) / _LOWER_QUARTILE


def is_followed(run: Forward) -> bool:
    """Return whether the innovations of all outputs are about as large as predicted."""
    return bool(np.all(squared_sizes(run) <= _RIGHT))


def misfit_std(variance: Array) -> Array:
    """Return the standard deviations (p,) in the median, for variances (K,p) of the model's error."""
    return np.asarray(np.sqrt(np.median(variance, axis=0)))


def said_of_misfit(eq: Equations, std: Array) -> Iterator[str]:
    """Yield a line for each output that the model cannot follow, for the standard deviations (p,) of its error."""
    for name, size in zip(eq.outputs, std.tolist(), strict=True):
        if size > 0.0:
            error = f"{size:.2g} {eq.units.get(name, '')}".rstrip()
            yield (
                f"{name}: the model cannot follow it with its disturbances; in the smoothed estimate its samples count "
                f"as if they had an error of {error} (a parameter is wrong, `ndob-fmu fit --free`, or the model lacks "
                "a force)"
            )


def variance_of_misfit(free: LinearRecord, columns: Jumps, events: Events) -> Array:
    """Return what the model's error adds to the variances (K,p) of the samples.

    free: the record with a disturbance that may do anything
    """
    variance = free.variance
    for _ in range(_MOST_PASSES):
        run = with_events(WholeRecord(replace(free, variance=variance)), columns, events).forward
        sizes = squared_sizes(run)
        too_large = np.isfinite(run.alpha) & (sizes > _RIGHT)
        if not too_large.any():
            break
        variance = variance + np.where(too_large, (sizes - 1.0) * np.where(too_large, run.alpha, 0.0), 0.0)
    return np.asarray(variance - free.variance)
