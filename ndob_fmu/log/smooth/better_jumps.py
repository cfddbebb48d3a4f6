"""Other instants for the jumps of a record, and one jump in place of two close ones.

A search that adds and gives up one event at a time ends where two events explain about what one at another instant
does, and where a jump stands beside its instant. So a jump, or a close pair, is taken away, and the best one near it
takes its place where the record is then more likely. A pair that goes there and back is no jump in two parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ndob_fmu.log.smooth.event_effects import AlongRecord, Source
from ndob_fmu.log.smooth.events import (
    AT_SAMPLE_COSTS,
    IN_STEP_COSTS,
    Events,
    Explained,
    Filtered,
    Jumps,
    with_events,
)
from ndob_fmu.log.smooth.gains import explained_by
from ndob_fmu.runtime.arrays import Array

# An instant, and whether the jump is in the step before it.
Jump = tuple[int, bool]
# Two jumps within so many spacings may stand for one.
_CLOSE = 4
# A gain of the log-likelihood that is worth another pass. Less of I − M is rounding errors.
_GAIN, _LEAST_LEFT = 0.5, 1e-12


def with_better_jumps(record: Filtered, columns: Jumps, spacing: int, first: int, found: Explained) -> Events:
    """Return the events of a record with jumps at better instants, the same ones where there are none.

    spacing: instants beside a jump at which it may be instead
    first: instants of the start, which have no jump
    """
    best = found
    for jump, better in _moves(columns, spacing, first, found):
        if jump in best.events.jumps.items():
            other = with_events(record, columns, _with(_without(best.events, jump), better))
            best = max(best, other, key=lambda one: one.value)
    for one, other_one in pairwise(sorted(best.events.jumps.items())):
        both_there = {one, other_one} <= {*best.events.jumps.items()}
        are_close = other_one[0] - one[0] <= _CLOSE * spacing
        if are_close and both_there and _change(columns, one, found) @ _change(columns, other_one, found) > 0.0:
            without = with_events(record, columns, _without(best.events, one, other_one))
            rows = slice(max(one[0] - spacing, first), other_one[0] + spacing + 1)
            told = without.adjoint.of_state[rows], without.adjoint.of_state_variance[rows]
            new, gained = _best(columns, rows, *told, without.events)
            if without.value + gained > best.value:
                best = with_events(record, columns, _with(without.events, new))
    return best.events if best.value > found.value + _GAIN else found.events


def _moves(columns: Jumps, spacing: int, first: int, found: Explained) -> Iterator[tuple[Jump, Jump]]:
    """Yield jumps, each with one that seems to explain more in its place."""
    jumps, score, variance = found.events.jumps, found.adjoint.of_state, found.adjoint.of_state_variance
    sources = [Source(k, columns.of(k, in_step)) for k, in_step in sorted(jumps.items())]
    every = [(one, one.columns.T @ score[one.k], _left(one, variance[one.k])) for one in sources]
    told = [(one, s, left) for one, s, left in every if np.linalg.eigvalsh(left)[0] > _LEAST_LEFT]
    if not told:
        return
    weights = [-np.asarray(np.linalg.inv(left)) for _, _, left in told]
    effects = AlongRecord(found).effects([one for one, _, _ in told], [s for _, s, _ in told], weights)
    for (source, s, left), weight, effect in zip(told, weights, effects, strict=True):
        k, jump = source.k, (source.k, jumps[source.k])
        rows = slice(max(k - spacing, first, effect.first), min(k + spacing + 1, effect.rows.stop))
        G = effect.of_state[rows.start - effect.first : rows.stop - effect.first]
        without = score[rows] - G @ weight @ s, variance[rows] - G @ weight @ np.swapaxes(G, 1, 2)
        better, gained = _best(columns, rows, *without, _without(found.events, jump))
        explains = 0.5 * (s @ np.linalg.solve(left, s) + np.linalg.slogdet(left)[1])
        if better != jump and gained > explains - Events(dict([jump])).costs + _GAIN:
            yield jump, better


def _change(columns: Jumps, jump: Jump, found: Explained) -> Array:
    """Return the change (N,) of ξ that the record tells of a jump."""
    k, in_step = jump
    each = columns.of(k, in_step)
    return np.asarray(each @ (each.T @ found.adjoint.of_state[k]))


def _left(one: Source, variance: Array) -> Array:
    return np.asarray(np.eye(one.columns.shape[1]) - one.columns.T @ variance @ one.columns)


def _best(columns: Jumps, rows: slice, score: Array, variance: Array, others: Events) -> tuple[Jump, float]:
    """Return the jump at rows where no other one is that explains most, and that less what it costs."""
    gained = np.array([
        explained_by(columns.at_sample[rows], score, variance) - AT_SAMPLE_COSTS,
        explained_by(columns.in_step[rows], score, variance) - IN_STEP_COSTS,
    ])  # fmt: skip
    gained[:, [k - rows.start for k in others.jumps if rows.start <= k < rows.stop]] = -np.inf
    in_step, place = divmod(int(np.argmax(gained)), gained.shape[1])
    return (rows.start + place, bool(in_step)), float(gained[in_step, place])


def _without(events: Events, *jumps: Jump) -> Events:
    return events.without(Events(dict(jumps)))


def _with(events: Events, jump: Jump) -> Events:
    return Events({**events.jumps, jump[0]: jump[1]}, events.outliers)
