"""Jumps of the disturbance and outliers in a record, found by the scores of the smoother.

A jump adds J ν to ξ at an instant, with ν ~ N(0, I). With the score l = Jᵀλ and its variance M = JᵀΛJ, that explains

    ½ (lᵀ (I + M)⁻¹ l − log det (I + M))

more of the record's log-likelihood, less what an event at this instant costs.

An outlier adds to one sample alone; there l and M are numbers. Each pass takes the best event of each stretch, then
smooths again, which also shows which events are not needed any more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import log

import numpy as np

from ndob_fmu.log.pieces import CutRecord, cut_record
from ndob_fmu.log.smoother import Adjoint, Forward, LinearRecord
from ndob_fmu.runtime.arrays import Array

# As online, a jump is expected every three hundredth sample, in seven of ten cases at a sample. An outlier is expected
# every fiftieth, 100 times as large as the noise.
_AT_SAMPLE_COSTS, _IN_STEP_COSTS, _OUTLIER_COSTS = -log(0.003 * 0.7), -log(0.003 * 0.3), -log(0.02)
_OUTLIER = 100.0
_MOST_PASSES = 40
# An event shows in the samples around it, too. Within so many spacings of a new one there is no other in the same pass.
_REACH = 10


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

    @property
    def costs(self) -> float:
        """Of all events, to be taken off the log-likelihood of a record that has them."""
        in_step = sum(self.jumps.values())
        at_sample = len(self.jumps) - in_step
        return _AT_SAMPLE_COSTS * at_sample + _IN_STEP_COSTS * in_step + _OUTLIER_COSTS * len(self.outliers)


@dataclass(frozen=True)
class Explained:
    """A record with its events: what the smoother finds with them."""

    record: LinearRecord
    events: Events
    forward: Forward
    adjoint: Adjoint


def explained(cut: CutRecord, columns: Jumps, spacing: int, first: int, known: Events | None = None) -> Explained:
    """Return a record with the events that explain it.

    columns: J of jumps
    spacing: instants within which there is one new event
    first: instants of the start, which have no jump
    known: events to begin with
    """
    events = known or Events()
    for _ in range(_MOST_PASSES):
        found = with_events(cut, columns, events)
        better = _better(found, columns, spacing, first)
        if better == events:
            break
        events = better
    return found


def cut_with_events(record: LinearRecord, overlap: int, wide: Array, columns: Jumps, events: Events) -> CutRecord:
    """Return `pieces.cut_record` for a record with some events."""
    return cut_record(record, overlap, wide, with_outliers(record.variance, events), columns.at(events.jumps))


def with_events(cut: CutRecord, columns: Jumps, events: Events) -> Explained:
    """Return what the smoother finds in a record with some events."""
    run, adjoint = cut.passes(with_outliers(cut.whole.variance, events), columns.at(events.jumps))
    return Explained(cut.whole, events, run, adjoint)


def with_outliers(variance: Array, events: Events) -> Array:
    """Return the variances (K,p) of the samples, larger for outliers."""
    variance = variance.copy()
    for k, i in events.outliers:
        variance[k, i] *= _OUTLIER**2
    return variance


def _better(found: Explained, columns: Jumps, spacing: int, first: int) -> Events:
    """Return the events without those that explain less than they cost, and with the best new ones."""
    events = found.events
    at_sample = _gained_by_jumps(found, columns, columns.at_sample) - _AT_SAMPLE_COSTS
    in_step = _gained_by_jumps(found, columns, columns.in_step) - _IN_STEP_COSTS
    of_jumps = np.maximum(at_sample, in_step)
    of_outliers = _gained_by_outliers(found) - _OUTLIER_COSTS
    of_jumps[:first] = -np.inf
    jumps = {k: kind for k, kind in events.jumps.items() if of_jumps[k] > 0.0}
    outliers = {(k, i) for k, i in events.outliers if of_outliers[k, i] > 0.0}
    # Where an outlier is known, there may be a jump in its place.
    taken = np.zeros(len(of_jumps), dtype=bool)
    for k in events.jumps:
        taken[max(k - spacing, 0) : k + spacing + 1] = True
    for k, i in events.outliers:
        of_outliers[k, i] = -np.inf
    best_outlier = of_outliers.max(axis=1)
    gained = np.maximum(of_jumps, best_outlier)
    for k in np.argsort(-gained, kind="stable").tolist():
        if not gained[k] > 0.0:
            break
        if taken[k]:
            continue
        taken[max(k - _REACH * spacing, 0) : k + _REACH * spacing + 1] = True
        if of_jumps[k] >= best_outlier[k]:
            jumps[k] = bool(in_step[k] > at_sample[k])
        else:
            outliers.add((k, int(np.argmax(of_outliers[k]))))
    return Events(jumps, frozenset(outliers))


def _gained_by_jumps(found: Explained, known: Jumps, columns: Array) -> Array:
    """Return what a jump with columns (K,N,c) explains at each instant (K,), of those that are known, what they do."""
    scores, variances = found.adjoint.of_state, found.adjoint.of_state_variance
    score = np.einsum("knc,kn->kc", columns, scores)
    variance = np.swapaxes(columns, 1, 2) @ variances @ columns
    for k, in_step in found.events.jumps.items():  # as without the one that is there
        J = known.of(k, in_step)
        inner = J.T @ variances[k] @ J
        back = columns[k].T @ variances[k] @ J @ np.linalg.solve(np.eye(len(inner)) - inner, J.T)
        score[k] += back @ scores[k]
        variance[k] += back @ variances[k] @ columns[k]
    whole = np.eye(columns.shape[2]) + variance
    told = np.linalg.solve(whole, score[:, :, None])[:, :, 0]
    return np.asarray(0.5 * (np.einsum("kc,kc->k", score, told) - np.linalg.slogdet(whole)[1]))


def _gained_by_outliers(found: Explained) -> Array:
    """Return what an outlier in each sample explains (K,p)."""
    more = found.record.variance * (_OUTLIER**2 - 1.0)
    score, variance = found.adjoint.of_sample.copy(), found.adjoint.of_sample_variance.copy()
    for k, i in found.events.outliers:
        without = 1.0 / (1.0 - more[k, i] * variance[k, i])
        score[k, i], variance[k, i] = without * score[k, i], without * variance[k, i]
    return np.asarray(0.5 * (score**2 * more / (1.0 + more * variance) - np.log1p(more * variance)))
