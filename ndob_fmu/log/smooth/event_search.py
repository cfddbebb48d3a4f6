"""The jumps and outliers that explain a record, found by the scores of the smoother.

With the score l = Jᵀλ of a jump and its variance M = JᵀΛJ, it explains

    ½ (lᵀ (I + M)⁻¹ l − log det (I + M))

more of the record's log-likelihood, less what an event at this instant costs. For an outlier l and M are numbers.

Each round takes the best event of each stretch, and gives up those that are not needed any more. What that does to the
scores around them is known without another pass over the record (`event_effects`). The last scores are those of a pass.
Where a filter forgets slowly, one jump shows in many stretches. So each event is judged anew once those before it are
there, and only then counts.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.better_jumps import with_better_jumps
from ndob_fmu.log.smooth.event_effects import Source
from ndob_fmu.log.smooth.event_scores import EventScores, Known
from ndob_fmu.log.smooth.events import (
    AT_SAMPLE_COSTS,
    IN_STEP_COSTS,
    OUTLIER,
    OUTLIER_COSTS,
    Events,
    Explained,
    Filtered,
    Jumps,
    with_events,
)
from ndob_fmu.log.smooth.gains import eliminated, explained_by
from ndob_fmu.log.smooth.rows import Rows, not_copied
from ndob_fmu.log.smooth.smoother import NEAR
from ndob_fmu.runtime.arrays import Array

# An instant and the output of an outlier, None for a jump.
Event = tuple[int, int | None]
# Passes over a record behind the best one, and rounds of changes between two of them.
_MOST_PASSES, _MOST_ROUNDS = 8, 40
# An event shows in the samples around it, too. Within so many spacings of a new one there is no other in the same
# round.
_REACH = 10
# One that was given up may come back, so many times: where events take turns, the search ends. A step of the
# disturbance needs one return, where an outlier or another instant stood for it first.
_MOST_RETURNS = 1


def explained(record: Filtered, columns: Jumps, spacing: int, first: int, known: Events | None = None) -> Explained:
    """Return a record with the events that explain it.

    columns: J of jumps
    spacing: instants within which there is one new event
    first: instants of the start, which have no jump
    known: events to begin with
    """
    return explained_from(with_events(record, columns, known or Events()), record, columns, spacing, first)


def explained_from(found: Explained, record: Filtered, columns: Jumps, spacing: int, first: int) -> Explained:
    """Do the same where the record with the events to begin with is filtered already."""
    taken, best, worse = Counter[Event](), found, 0
    while worse < _MOST_PASSES:
        search = Search(found, columns, spacing, first, taken)
        search.run()
        better = search.events
        if better == found.events:
            better = with_better_jumps(record, columns, spacing, first, found)
            if better == found.events:
                break
        found = with_events(record, columns, better)
        best, worse = (found, 0) if found.value > best.value else (best, worse + 1)
    return best


class _Change(NamedTuple):
    """An event that comes or goes; is_judged: whether that depends on what it explains by itself."""

    event: Events
    source: Source
    is_new: bool
    is_judged: bool


class Search:
    """The search from one pass over the record on.

    taken: how often each event was taken, which it counts
    events, scores: as they are by now
    """

    def __init__(self, found: Explained, columns: Jumps, spacing: int, first: int, taken: Counter[Event]) -> None:
        self.events = found.events
        self._columns, self._spacing, self._first, self._taken = columns, spacing, first, taken
        size = np.sqrt(found.record.variance * (OUTLIER**2 - 1.0))
        self.scores = EventScores(found, self._jumps(found.events), size)
        K, p = size.shape
        self._at_sample, self._in_step, self._outliers = np.empty(K), np.empty(K), np.empty((K, p))
        self._judge(np.arange(K))

    def run(self) -> None:
        """Change the events until they explain the record, or another pass is faster."""
        for _ in range(_MOST_ROUNDS):
            better = self._better()
            if better == self.events:
                break
            self.change(better, at_once=False)
            if not self._goes_on:
                break

    @property
    def _goes_on(self) -> bool:
        """Whether the scores are known well enough, and a pass takes longer than what was done with them."""
        return self.scores.are_known and self.scores.rows < len(self.scores.of_state)

    def change(self, better: Events, *, at_once: bool = True) -> None:
        """Take these events in place of those that were there.

        at_once: whether all of them; else those that are better where the ones before them are changed already
        """
        left, done = deque(self._changes(better)), list[_Change]()
        touched = np.zeros(len(self.scores.of_state), dtype=bool)
        while left and self.scores.are_known and (at_once or self._goes_on):
            one = left.popleft()
            if at_once or not one.is_judged or one.is_new == (self.scores.explains(one.source) > one.event.costs):
                touched[self.scores.add(one.source) if one.is_new else self.scores.take_away(one.source)] = True
                done.append(one)
        # What is left is not judged. An outlier explains its own sample; jumps that reach far may explain the same.
        is_alone = at_once or len(left) * self.scores.reach < len(touched)
        done += [one for one in left if is_alone or one.source.output is not None]
        for one in done:
            self.events = self.events.and_then(one.event, 0) if one.is_new else self.events.without(one.event)
        self._taken.update([(one.source.k, one.source.output) for one in done if one.is_new])
        if self.scores.are_known and (at_once or self._goes_on):
            self._judge(np.flatnonzero(touched))
            # Rounding errors of changes may leave no variance. At a jump that explains nearly everything that is usual.
            others = np.setdiff1d(np.flatnonzero(touched), [*self.events.jumps])
            if np.isneginf([self._at_sample[others], self._in_step[others]]).any():
                self.scores.are_known = False

    def _changes(self, better: Events) -> list[_Change]:
        """Return what other events change: what is not judged, what goes, then what is new; the clearest ones first."""
        gone, new = self.events.without(better), better.without(self.events)
        moved, found = {*gone.jumps} & {*new.jumps}, list[tuple[float, _Change]]()
        for events, is_new in ((gone, False), (new, True)):
            for k, in_step in events.jumps.items():
                gained = (self._in_step if in_step else self._at_sample)[k]
                source, is_judged = Source(k, self._columns.of(k, in_step)), k not in moved and (gained > 0.0) == is_new
                found.append((gained, _Change(Events({k: in_step}), source, is_new, is_judged)))
            for one in events.outliers:
                source = self.scores.outliers.source(one)
                found.append((self._outliers[one], _Change(Events(outliers=frozenset([one])), source, is_new, True)))
        found.sort(key=lambda one: (one[1].is_judged, one[1].is_new, -one[0] if one[1].is_new else one[0]))
        return [one for _, one in found]

    @property
    def gained(self) -> tuple[Array, Array, Array]:
        """What jumps at samples, jumps in steps (K,) and outliers (K,p) explain, less what they cost."""
        return self._at_sample, self._in_step, self._outliers

    def _jumps(self, events: Events) -> list[Source]:
        return [Source(k, self._columns.of(k, in_step)) for k, in_step in sorted(events.jumps.items())]

    def _judge(self, rows: NDArray[np.intp]) -> None:
        """Find what events at some rows explain, less what they cost."""
        for some in map(not_copied, np.array_split(rows, len(rows) // NEAR + 1)):
            self._at_sample[some] = self._gained_by_jumps(some, self._columns.at_sample) - AT_SAMPLE_COSTS
            self._in_step[some] = self._gained_by_jumps(some, self._columns.in_step) - IN_STEP_COSTS
            self._outliers[some] = self._gained_by_outliers(some) - OUTLIER_COSTS

    def _better(self) -> Events:
        """Return the events without those that explain less than they cost, and with the best new ones."""
        events, spacing, (at_sample, in_step, outliers_gained) = self.events, self._spacing, self.gained
        of_jumps, of_outliers = np.maximum(at_sample, in_step), outliers_gained.copy()
        of_jumps[: self._first] = -np.inf
        jumps = {
            k: bool(in_step[k] > at_sample[k]) if self._may_return((k, None)) else kind
            for k, kind in events.jumps.items()
            if of_jumps[k] > 0.0
        }
        if any(kind != events.jumps[k] for k, kind in jumps.items()):
            # Until a jump is where it is, nearly any other event explains what it leaves.
            return Events({**events.jumps, **jumps}, events.outliers)
        outliers = {(k, i) for k, i in events.outliers if of_outliers[k, i] > 0.0}
        for k, i in self._taken:
            if self._may_return((k, i)):
                continue
            if i is None:
                of_jumps[k] = -np.inf
            else:
                of_outliers[k, i] = -np.inf
        # Where an outlier is known, there may be a jump in its place.
        taken = np.zeros(len(of_jumps), dtype=bool)
        taken[[*events.jumps]] = True
        for k, i in events.outliers:
            of_outliers[k, i] = -np.inf
        best_outlier = of_outliers.max(axis=1)
        gained = np.maximum(of_jumps, best_outlier)
        candidates = np.flatnonzero((gained > 0.0) & ~taken)
        for k in candidates[np.argsort(-gained[candidates], kind="stable")].tolist():
            if taken[k]:
                continue
            taken[max(k - _REACH * spacing, 0) : k + _REACH * spacing + 1] = True
            if of_jumps[k] >= best_outlier[k]:
                jumps[k] = bool(in_step[k] > at_sample[k])
            else:
                outliers.add((k, int(np.argmax(of_outliers[k]))))
        return Events(jumps, frozenset(outliers))

    def _may_return(self, event: Event) -> bool:
        return self._taken[event] <= _MOST_RETURNS

    def _gained_by_jumps(self, rows: Rows, columns: Array) -> Array:
        """Return what a jump with columns (K,N,c) explains at rows, of those that are known, what they do."""
        scores, variances = self.scores.of_state, self.scores.of_state_variance
        gained = explained_by(columns[rows], scores[rows], variances[rows])
        for place, known in self._jumps_at(rows):  # as without the one that is there
            k = known.source.k
            is_own = columns[k].shape == known.source.columns.shape
            gained[place] = known.explains if is_own else _in_place_of(known, columns[k], scores[k], variances[k])
        return gained

    def _gained_by_outliers(self, rows: Rows) -> Array:
        """Return what an outlier in each sample explains at rows (·,p)."""
        known = self.scores.outliers
        size, are_there = known.size[rows], known.are_there[rows]
        # Rounding errors of changes may leave less than nothing.
        variance = size**2 * np.maximum(self.scores.of_sample_variance[rows], 0.0)
        score = size * self.scores.of_sample[rows]
        without = 1.0 / known.left[rows][are_there]
        score[are_there], variance[are_there] = without * known.score[rows][are_there], without - 1.0
        return np.asarray(0.5 * (score**2 / (1.0 + variance) - np.log1p(variance)))

    def _jumps_at(self, rows: Rows) -> Iterator[tuple[int, Known]]:
        """Yield the jumps that are known at rows, and their places there."""
        known = [*self.scores.jumps.items()]
        if isinstance(rows, slice):
            yield from ((k - rows.start, one) for k, one in known if rows.start <= k < rows.stop)
            return
        places = np.searchsorted(rows, [k for k, _ in known]).tolist()
        for place, (k, one) in zip(places, known, strict=True):
            if place < len(rows) and rows[place] == k:
                yield place, one


def _in_place_of(known: Known, columns: Array, score: Array, variance: Array) -> float:
    """Return what a jump with columns (N,c) explains in place of one that is known at its instant.

    −∞ where rounding errors leave nothing of I − M.
    """
    if not np.isfinite(known.explains):
        return -np.inf
    across = columns.T @ variance @ known.source.columns
    without = np.linalg.solve(known.left, np.column_stack([across.T, known.score]))
    own_score = columns.T @ score + across @ without[:, -1]
    own_variance = columns.T @ variance @ columns + across @ without[:, :-1]
    return float(eliminated(own_score[None], own_variance[None])[0])
