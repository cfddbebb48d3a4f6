"""The noise of the samples and the pace of the disturbance under which a record is most likely, jumps included.

What the likelihood of a record without jumps prefers is a disturbance that is fast enough for its jumps, everywhere. So
jumps and outliers are found in turn with noise and pace; each is a part of the likelihood, and costs (`events`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ndob_fmu.log.fit.likelihood import Moved, faster, likelihood
from ndob_fmu.log.fit.noise_columns import of_each_disturbance
from ndob_fmu.log.fit.noise_slopes import covariances_of_pace, noise_slopes
from ndob_fmu.log.smooth.event_search import explained
from ndob_fmu.log.smooth.events import Events, Jumps
from ndob_fmu.log.smooth.linear_record import Forward, LinearRecord
from ndob_fmu.log.smooth.pieces import CutRecord
from ndob_fmu.log.smooth.smoother import backward, lower_factor
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.layout import Layout

_MOST_TURNS = 4
# Logarithms of variances: of no use beyond. That is the standard deviation of one that a record does not tell, too.
UNKNOWN = 40.0
_MOVED = 1e-4
# Steps to the most likely ones, at most, of at most so much in a logarithm. One that gains less is not worth another,
# and a likelihood that is less than before by as much shows a step that was too long.
_MOST_STEPS, _LONGEST, _GAIN = 40, 3.0, 0.02
# Where a logarithm has moved by more, the information is taken anew.
_FAR = 3.0
# A curvature that was seen along a step counts down to this part of the expected one.
_FLAT = 0.1
# A gain of the log-likelihood that chance does not explain.
_SURE = 10.0


@dataclass(frozen=True)
class NoiseFit:
    """What was found.

    log_variance (p,), log_intensity (q2,): of factors on what the record was made with
    precision (p + q2,p + q2): of both, as the search saw it, from the information where it was taken last
    events: jumps and outliers
    value: log-likelihood less the costs of the events
    """

    log_variance: Array
    log_intensity: Array
    precision: Array
    events: Events
    value: float

    @property
    def logs(self) -> Array:
        """Both logarithms (p + q2,)."""
        return np.concatenate([self.log_variance, self.log_intensity])

    @property
    def std(self) -> Array:
        """Of both, about (p + q2,)."""
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.precision))))

    def for_intensity(self, old: Array, new: Array) -> NoiseFit:
        """Return the same pace for a record that was made with other intensities (q2,)."""
        return replace(self, log_intensity=self.log_intensity + np.log(old / new))

    def applied(self, record: LinearRecord, layout: Layout) -> LinearRecord:
        """Return a record with the noise and pace that were found."""
        noisy = replace(record, variance=record.variance * np.exp(self.log_variance))
        return faster(noisy, layout, np.exp(self.log_intensity))

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
    # Pieces may leave out the last rows, in which an event may be known.
    events = Events() if start is None else start.events.before(len(record.whole.rows))
    noise = NoiseLikelihood(record, layout, search.columns)
    at = np.zeros(p + q) if start is None else start.logs
    known = noise.precision(at, events) if start is None else start.precision
    for _ in range(_MOST_TURNS):
        at, value, known = _most_likely(noise, events, at, known)
        found = search.within(_scaled(record, layout, at), events)
        if found == events:
            break
        events = found
    else:
        value = noise.at(at, events).value
    return NoiseFit(at[:p], at[p:], known, events, value - events.costs)


def is_jumping(record: CutRecord, search: EventSearch, layout: Layout, found: NoiseFit) -> bool:
    """Return whether the jumps that were found explain more than another pace without them, and more than chance."""
    if not found.events.jumps:
        return False
    others = Events(outliers=found.events.outliers)
    noise = NoiseLikelihood(record, layout, search.columns)
    _, without, _ = _most_likely(noise, others, found.logs, found.precision)
    return found.value > without - others.costs + _SURE


def moved(record: CutRecord, layout: Layout, columns: Jumps, at: Array) -> tuple[Moved, list[Moved]]:
    """Return a record with factors of logarithms (p + q2,) on noise and pace, and with each of these moved.

    All of them have the same noise in N columns; where a pace is moved, those of its disturbance stand beside it.
    """
    here = _scaled(record, layout, at)
    joined, more = lower_factor(here.parts.noise), np.sqrt(np.expm1(_MOVED))
    centre = _with_noise(here, joined)
    noisier = [_noisier(centre, factors) for factors in np.exp(_MOVED * np.eye(record.whole.variance.shape[1]))]
    paced = [
        _with_noise(here, np.concatenate([joined, more * each], axis=-1))
        for each in of_each_disturbance(here.parts.noise, layout.q)
    ]
    return Moved(centre, columns), [Moved(one, columns, _MOVED) for one in (*noisier, *paced)]


@dataclass(frozen=True)
class NoiseLikelihood:
    """A record whose noise and pace have factors, and the columns of jumps in it."""

    record: CutRecord
    layout: Layout
    columns: Jumps

    def at(self, logs: Array, events: Events) -> _Point:
        """Return the likelihood at logarithms (p + q2,) of these factors."""
        return _Point(self, logs, Moved(_scaled(self.record, self.layout, logs), self.columns), events)

    def precision(self, logs: Array, events: Events) -> Array:
        """Return the information about these logarithms (m,m), with a wide prior for what the record does not tell."""
        found = likelihood(*moved(self.record, self.layout, self.columns, logs), events)
        return np.asarray(found.information + np.eye(len(logs)) / UNKNOWN**2)

    @cached_property
    def of_pace(self) -> Array:
        """As `covariances_of_pace`, of the record as it is."""
        return covariances_of_pace(self.record.parts, self.layout.q)


@dataclass(frozen=True)
class _Point:
    """The likelihood at some noise and pace. Each number is computed when it is first asked for."""

    noise: NoiseLikelihood
    logs: Array
    told: Moved
    events: Events

    @cached_property
    def value(self) -> float:
        """L."""
        return float(self.told.values(self._run).sum())

    @cached_property
    def slopes(self) -> Array:
        """∂L by the logarithms (p + q2,)."""
        parts, of_pace, pieces = self.told.with_events(self.events), self.noise.of_pace, self.noise.record.pieces
        slopes = self._slopes(parts, self._run, of_pace)
        if len(pieces.first) == 1 or not pieces.begins:
            return slopes
        return slopes - self._slopes(*self.noise.record.begins(parts, self._run), of_pace[: pieces.begins - 1, 1:])

    def _slopes(self, parts: LinearRecord, run: Forward, of_pace: Array) -> Array:
        factors = np.exp(self.logs[-self.noise.layout.q :])
        return noise_slopes(parts, backward(parts, run), of_pace, factors)

    @cached_property
    def _run(self) -> Forward:
        return self.told.filtered(self.events)


def _scaled(record: CutRecord, layout: Layout, at: Array) -> CutRecord:
    """Return a record with factors of logarithms (p + q2,)."""
    variance, intensity = np.split(np.exp(at), [record.whole.variance.shape[1]])
    noisier = _noisier(record, variance)
    return replace(noisier, parts=faster(noisier.parts, layout, intensity))


def _noisier(record: CutRecord, factors: Array) -> CutRecord:
    """Return a record with factors (p,) on the variances of the samples."""
    whole, parts = (replace(one, variance=one.variance * factors) for one in (record.whole, record.parts))
    return replace(record, whole=whole, parts=parts)


def _with_noise(record: CutRecord, noise: Array) -> CutRecord:
    """Return a record whose pieces have other noise (L-1,S,N,·)."""
    return replace(record, parts=replace(record.parts, noise=noise))


def _most_likely(noise: NoiseLikelihood, events: Events, at: Array, precision: Array) -> tuple[Array, float, Array]:
    """Return the most likely logarithms (p + q2,), the likelihood about there, and a precision.

    precision: to begin with

    Steps of Fisher's scoring, which takes the information that a right model has. That costs as much as many steps, so
    it is taken anew only where the logarithms have moved far; in between, what a step found counts in the next ones, as
    in BFGS.
    """
    here, taken_at = noise.at(at, events), at
    for _ in range(_MOST_STEPS):
        scored = np.asarray(np.linalg.solve(precision, here.slopes))
        step = np.clip(at + _in_logarithms(scored), -UNKNOWN, UNKNOWN) - at
        if min(here.slopes @ scored, np.abs(here.slopes) @ np.abs(step)) < _GAIN:
            return at + step, here.value, precision
        further = noise.at(at + step, events)
        if further.value < here.value - _GAIN:
            step = scored * np.max(np.abs(step)) / np.max(np.abs(scored))  # straight up, however little
        while further.value < here.value - _GAIN:
            step = 0.5 * step
            further = noise.at(at + step, events)
        at = at + step
        if np.max(np.abs(at - taken_at)) > _FAR:
            precision, taken_at = noise.precision(at, events), at
        precision = _as_seen(precision, step, here.slopes - further.slopes)
        here = further
    return at, here.value, precision


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
