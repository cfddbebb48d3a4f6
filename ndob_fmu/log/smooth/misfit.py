"""Outputs that the model cannot follow, as where a parameter is wrong that does not act as the disturbance does.

Innovations of a right model have E e² = α. Where they are larger as a rule, also with a disturbance that may do
anything, the error is the model's. Two records explain it. In one R of that output is enlarged by what is left: its
samples no longer carry the error into the disturbance, and are no longer taken for outliers by the dozen. In the other
what the output shows wanders beside the model, and the samples are believed. The more likely one counts: a wrong flow
into a chamber moves its pressure, however exact the sensor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

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
# By this factor the variance of what wanders falls, from that of the samples on, as long as it gets more likely.
_CALMER, _MOST_CALMER = 0.1, 10


@dataclass(frozen=True)
class ModelError:
    """What the model's error adds to the samples, or to what they show.

    variance (K,p): of the samples
    wanders (p,): standard deviation per √s of what an output shows, beside the model
    """

    variance: Array
    wanders: Array

    @property
    def sizes(self) -> Array:
        """The standard deviations (2,p): that of the samples, in the median, and that of what wanders."""
        return np.array([np.sqrt(np.median(self.variance, axis=0)), self.wanders])

    def added_to(self, record: LinearRecord, state_std: Array, step: Array) -> LinearRecord:
        """Return a record with this error; state_std (n,): how much states vary, step (K-1,): in s."""
        record = replace(record, variance=record.variance + self.variance)
        if not self.wanders.any():
            return record
        rows, n = record.rows[:-1], len(state_std)
        shares = np.zeros_like(rows)  # of the states in what moves an output by 1, the least ones for their sizes
        shares[..., :n] = rows[..., :n] * state_std**2
        moved = np.einsum("kpn,kpn->kp", shares, rows)[..., None]
        shares = np.divide(shares, moved, out=np.zeros_like(rows), where=moved > 0.0)
        columns = shares * (self.wanders * np.sqrt(step)[:, None])[..., None]
        return replace(record, noise=np.concatenate([record.noise, np.swapaxes(columns, 1, 2)], axis=2))


def no_error(record: LinearRecord) -> ModelError:
    """Return the error of a model that is right."""
    return ModelError(np.zeros_like(record.variance), np.zeros(record.variance.shape[1]))


def squared_sizes(run: Forward) -> Array:
    """Return how large the squared innovations of each output (p,) are over their variance, as a rule; 1 is right."""
    ratios = np.where(np.isfinite(run.alpha), run.innovation**2 / run.alpha, np.nan).T
    return np.array([np.nanquantile(one, 0.25) if np.isfinite(one).any() else 0.0 for one in ratios]) / _LOWER_QUARTILE


def is_followed(run: Forward) -> bool:
    """Return whether the innovations of all outputs are about as large as predicted."""
    return bool(np.all(squared_sizes(run) <= _RIGHT))


def said_of_misfit(eq: Equations, sizes: Array) -> Iterator[str]:
    """Yield a line for each output that the model cannot follow, for `ModelError.sizes` (2,p)."""
    for name, of_sample, wanders in zip(eq.outputs, *sizes.tolist(), strict=True):
        if not of_sample and not wanders:
            continue
        error = f"{wanders or of_sample:.2g} {eq.units.get(name, '')}".rstrip()
        of_sample_text = f"its samples count as if they had an error of {error}"
        what = f"it moves by {error} in 1 s beside it" if wanders else of_sample_text
        yield (
            f"{name}: the model cannot follow it with its disturbances; in the smoothed estimate {what} (a parameter "
            "is wrong, `ndob-fmu fit --free`, or the model lacks something)"
        )


def error_of_model(
    record: LinearRecord, free: LinearRecord, columns: Jumps, events: Events, state_std: Array, step: Array
) -> ModelError:
    """Return the error that explains a record best.

    free: the record with a disturbance that may do anything; state_std, step: as for `ModelError.added_to`
    """

    def likelihood(error: ModelError) -> float:
        told = WholeRecord(error.added_to(record, state_std, step))
        return float(with_events(told, columns, events).forward.log_likelihoods.sum())

    of_samples = ModelError(_variance_of_misfit(free, columns, events), np.zeros(free.rows.shape[1]))
    best, most = of_samples, likelihood(of_samples)
    wanders, before = of_samples.sizes[0] / np.sqrt(np.median(step)), -np.inf
    for _ in range(_MOST_CALMER):
        error = ModelError(np.zeros_like(of_samples.variance), wanders)
        value = likelihood(error)
        if value > most:
            best, most = error, value
        if value < before:
            break
        wanders, before = wanders * np.sqrt(_CALMER), value
    return best


def _variance_of_misfit(free: LinearRecord, columns: Jumps, events: Events) -> Array:
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
