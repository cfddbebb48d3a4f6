"""The noise of the samples and the pace of the disturbance under which a record is most likely, jumps included.

What the likelihood of a record without jumps prefers is a disturbance that is fast enough for its jumps, everywhere. So
jumps and outliers are found in turn with noise and pace; each is a part of the likelihood, and costs (`events`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ndob_fmu.log.fit.likelihood import Likelihood, Moved, likelihood, scaled
from ndob_fmu.log.smooth.event_search import explained
from ndob_fmu.log.smooth.events import Events, Jumps
from ndob_fmu.log.smooth.linear_record import LinearRecord
from ndob_fmu.log.smooth.pieces import CutRecord
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.layout import Layout

_MOST_TURNS = 4
# Logarithms of variances: of no use beyond. That is the standard deviation of one that a record does not tell, too.
UNKNOWN = 40.0
_MOVED = 1e-4
# Steps to the most likely ones, at most, of at most so much in a logarithm. One that gains less is not worth another,
# and a likelihood that is less than before by as much shows a step that was too long.
_MOST_STEPS, _LONGEST, _GAIN = 40, 3.0, 0.02
# A curvature that was seen along a step counts down to this part of the expected one.
_FLAT = 0.1
# A gain of the log-likelihood that chance does not explain.
_SURE = 10.0


@dataclass(frozen=True)
class NoiseFit:
    """What was found.

    log_variance (p,), log_intensity (q2,): of factors on what the record was made with
    covariance (p + q2,p + q2): of both
    events: jumps and outliers
    value: log-likelihood less the costs of the events
    """

    log_variance: Array
    log_intensity: Array
    covariance: Array
    events: Events
    value: float

    @property
    def logs(self) -> Array:
        """Both logarithms (p + q2,)."""
        return np.concatenate([self.log_variance, self.log_intensity])

    def for_intensity(self, old: Array, new: Array) -> NoiseFit:
        """Return the same pace for a record that was made with other intensities (q2,)."""
        return replace(self, log_intensity=self.log_intensity + np.log(old / new))

    def applied(self, record: LinearRecord, layout: Layout) -> LinearRecord:
        """Return a record with the noise and pace that were found."""
        return scaled(record, layout, np.exp(self.log_variance), np.exp(self.log_intensity))

    def cut(self, record: CutRecord, layout: Layout) -> CutRecord:
        """Return a record in pieces with the noise and pace that were found."""
        return _scaled(record, layout, self.logs)


@dataclass(frozen=True)
class EventSearch:
    """Where events may be, as in `events.explained`: `spacing` and `first` in rows, `columns` of jumps."""

    columns: Jumps
    spacing: int
    first: int

    def within(self, record: CutRecord, known: Events) -> Events:
        """Return the events of a record."""
        return explained(record, self.columns, self.spacing, self.first, known).events


def fit_noise(record: CutRecord, search: EventSearch, layout: Layout, start: NoiseFit | None) -> NoiseFit:
    """Return the noise of each output and the pace of each disturbance; `start`: where to begin."""
    p, q = record.whole.variance.shape[1], layout.q
    at = np.zeros(p + q) if start is None else start.logs
    # Pieces may leave out the last rows, in which an event may be known.
    events = Events() if start is None else start.events.before(len(record.whole.rows))
    for _ in range(_MOST_TURNS):
        at, told = _most_likely(record, layout, search.columns, events, at)
        found = search.within(_scaled(record, layout, at), events)
        if found == events:
            break
        events = found
    else:
        told = _told(record, layout, search.columns, events, at)
    covariance = np.asarray(np.linalg.inv(_precision(told.information)))
    return NoiseFit(at[:p], at[p:], covariance, events, told.value - events.costs)


def is_jumping(record: CutRecord, search: EventSearch, layout: Layout, found: NoiseFit) -> bool:
    """Return whether the jumps that were found explain more than another pace without them, and more than chance."""
    if not found.events.jumps:
        return False
    others = Events(outliers=found.events.outliers)
    _, without = _most_likely(record, layout, search.columns, others, found.logs)
    return found.value > without.value - others.costs + _SURE


def moved(record: CutRecord, layout: Layout, columns: Jumps, at: Array) -> tuple[Moved, list[Moved]]:
    """Return a record with factors of logarithms (p + q2,) on noise and pace, and with each of these moved."""
    return Moved(_scaled(record, layout, at), columns), [
        Moved(_scaled(record, layout, at + step), columns, _MOVED) for step in _MOVED * np.eye(len(at))
    ]


def _told(record: CutRecord, layout: Layout, columns: Jumps, events: Events, at: Array) -> Likelihood:
    return likelihood(*moved(record, layout, columns, at), events)


def _scaled(record: CutRecord, layout: Layout, at: Array) -> CutRecord:
    variance, intensity = np.split(np.exp(at), [record.whole.variance.shape[1]])
    whole = replace(record.whole, variance=record.whole.variance * variance)
    return replace(record, whole=whole, parts=scaled(record.parts, layout, variance, intensity))


def _most_likely(
    record: CutRecord, layout: Layout, columns: Jumps, events: Events, at: Array
) -> tuple[Array, Likelihood]:
    """Return the most likely logarithms (p + q2,), by steps of Fisher's scoring, and the likelihood about there.

    Scoring takes the information that a right model has. That a step found counts in the next one, as in BFGS.
    """
    told = _told(record, layout, columns, events, at)
    precision = _precision(told.information)
    for _ in range(_MOST_STEPS):
        scored = np.asarray(np.linalg.solve(precision, told.slopes))
        step = np.clip(at + _in_logarithms(scored), -UNKNOWN, UNKNOWN) - at
        if min(told.slopes @ scored, np.abs(told.slopes) @ np.abs(step)) < _GAIN:
            return at + step, told
        further = _told(record, layout, columns, events, at + step)
        if further.value < told.value - _GAIN:
            step = scored * np.max(np.abs(step)) / np.max(np.abs(scored))  # straight up, however little
        while further.value < told.value - _GAIN:
            step = 0.5 * step
            further = _told(record, layout, columns, events, at + step)
        precision = _as_seen(_precision(further.information), step, told.slopes - further.slopes)
        at, told = at + step, further
    return at, told


def _in_logarithms(step: Array) -> Array:
    """Return a step of logarithms that was scored as one of variances, whose likelihood is nearer to a parabola."""
    return np.asarray(np.log1p(np.clip(step, np.expm1(-_LONGEST), np.expm1(_LONGEST))))


def _as_seen(precision: Array, step: Array, fall: Array) -> Array:
    """Return a precision (m,m) that explains by how much the slopes (m,) fell in a step (m,)."""
    expected = precision @ step
    along, seen = float(expected @ step), float(fall @ step)
    if seen < _FLAT * along:
        return precision
    return np.asarray(precision - np.outer(expected, expected) / along + np.outer(fall, fall) / seen)


def _precision(information: Array) -> Array:
    """Return an information, with that of a wide prior for what the record does not tell."""
    return np.asarray(information + np.eye(len(information)) / UNKNOWN**2)
