"""Jumps of the disturbance and outliers in a record: what they add to it, what they cost, a record with some of them.

A jump adds J ν to ξ at an instant, with ν ~ N(0, I). An outlier is a sample with a larger variance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import log
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.linear_record import Adjoint, Forward, LinearRecord
from ndob_fmu.runtime.arrays import Array

# As online, a jump is expected every three hundredth sample, in seven of ten cases at a sample. An outlier is expected
# every fiftieth, 100 times as large as the noise.
AT_SAMPLE_COSTS, IN_STEP_COSTS, OUTLIER_COSTS = -log(0.003 * 0.7), -log(0.003 * 0.3), -log(0.02)
OUTLIER = 100.0


@dataclass(frozen=True)
class Jumps:
    """The columns J of a jump of d, for each of K instants.

    at_sample (K,N,c1): of one at the instant
    in_step (K,N,c2): of one in the step before it
    """

    at_sample: Array
    in_step: Array

    def of(self, k: int, in_step: bool) -> Array:
        """Return J (N,·) of a jump at an instant, or in the step before it."""
        return np.asarray((self.in_step if in_step else self.at_sample)[k])

    def some(self, rows: slice) -> Jumps:
        """Return those of some instants."""
        return Jumps(self.at_sample[rows], self.in_step[rows])

    def at(self, jumps: Mapping[int, bool]) -> dict[int, Array]:
        """Return J (N,·) of some jumps, by the number of their instant."""
        return {k: self.of(k, in_step) for k, in_step in jumps.items()}


@dataclass(frozen=True)
class Events:
    """What happened in a record, by the numbers of its instants.

    jumps: for each jump of d, whether it is in the step before the instant
    outliers: pairs of an instant and an output
    """

    jumps: Mapping[int, bool] = field(default_factory=dict)
    outliers: frozenset[tuple[int, int]] = frozenset()

    def and_then(self, others: Events, first: int) -> Events:
        """Return these and those of a record that begins at an instant of this one."""
        outliers = {(first + k, i) for k, i in others.outliers}
        return Events({**self.jumps, **{first + k: kind for k, kind in others.jumps.items()}}, self.outliers | outliers)

    def before(self, K: int) -> Events:
        """Return those at the first K instants."""
        jumps = {k: in_step for k, in_step in self.jumps.items() if k < K}
        return Events(jumps, frozenset((k, i) for k, i in self.outliers if k < K))

    def without(self, others: Events) -> Events:
        """Return the events that others do not have."""
        jumps = {k: in_step for k, in_step in self.jumps.items() if others.jumps.get(k) != in_step}
        return Events(jumps, self.outliers - others.outliers)

    @property
    def costs(self) -> float:
        """Of all events, to be taken off the log-likelihood of a record that has them."""
        in_step = sum(self.jumps.values())
        at_sample = len(self.jumps) - in_step
        return AT_SAMPLE_COSTS * at_sample + IN_STEP_COSTS * in_step + OUTLIER_COSTS * len(self.outliers)


@dataclass(frozen=True)
class Explained:
    """A record with its events: what the smoother finds with them.

    ends (·,): rows behind which another record begins
    """

    record: LinearRecord
    events: Events
    forward: Forward
    adjoint: Adjoint
    ends: NDArray[np.intp]

    @cached_property
    def value(self) -> float:
        """The log-likelihood of the samples, less what the events cost."""
        return float(self.forward.log_likelihoods.sum()) - self.events.costs


class Filtered(Protocol):
    """What filters a record: as a whole, or in pieces that know nothing of each other."""

    @property
    def whole(self) -> LinearRecord:
        """The record."""

    @property
    def ends(self) -> NDArray[np.intp]:
        """Rows behind which another piece begins."""

    def passes(self, variance: Array, jumps: Mapping[int, Array]) -> tuple[Forward, Adjoint]:
        """Return, by row (K,…), what filter and adjoint find with variances (K,p) of the samples.

        jumps: columns (N,·) that are added to the factor of P⁻ at an instant
        """


def with_events(record: Filtered, columns: Jumps, events: Events) -> Explained:
    """Return what the smoother finds in a record with some events."""
    run, adjoint = record.passes(with_outliers(record.whole.variance, events), columns.at(events.jumps))
    return Explained(record.whole, events, run, adjoint, record.ends)


def with_outliers(variance: Array, events: Events) -> Array:
    """Return the variances (K,p) of the samples, larger for outliers."""
    variance = variance.copy()
    for k, i in events.outliers:
        variance[k, i] *= OUTLIER**2
    return variance
