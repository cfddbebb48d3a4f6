"""The noise of the samples and the pace of the disturbance under which a record is most likely, jumps included.

What the likelihood of a record without jumps prefers is a disturbance that is fast enough for its jumps, everywhere. So
jumps and outliers are found in turn with noise and pace; each is a part of the likelihood, and costs (`events`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np
from scipy.optimize import minimize

from ndob_fmu.log.events import Events, Jumps, explained
from ndob_fmu.log.fit.likelihood import Likelihood, likelihood, scaled
from ndob_fmu.log.pieces import CutRecord
from ndob_fmu.log.smoother import LinearRecord
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.layout import Layout

_MOST_TURNS = 4
# Logarithms of variances: of no use beyond, and a record that does not say them ends there.
_FARTHEST = 40.0
_STEP = 1e-3
# A gain of the log-likelihood that chance does not explain.
_SURE = 10.0


@dataclass(frozen=True)
class NoiseFit:
    """What was found.

    log_variance (p,), log_intensity (q2,): of factors on what the record was made with
    covariance (p + q2,p + q2): of both
    events: jumps and outliers
    value: log-likelihood less the costs of the events
    value_without: the same without any event
    """

    log_variance: Array
    log_intensity: Array
    covariance: Array
    events: Events
    value: float
    value_without: float

    @property
    def is_jumping(self) -> bool:
        """Whether jumps explain more than chance."""
        return bool(self.events.jumps) and self.value > self.value_without + _SURE

    def applied(self, record: LinearRecord, layout: Layout) -> LinearRecord:
        """Return a record with the noise and pace that were found."""
        return scaled(record, layout, np.exp(self.log_variance), np.exp(self.log_intensity))

    def cut(self, record: CutRecord, layout: Layout) -> CutRecord:
        """Return a record in pieces with the noise and pace that were found."""
        return _scaled(record, layout, np.concatenate([self.log_variance, self.log_intensity]))


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
    at = np.zeros(p + q) if start is None else np.concatenate([start.log_variance, start.log_intensity])
    events, without = (Events(), inf) if start is None else (start.events, start.value_without)
    for turn in range(_MOST_TURNS):
        at, value = _most_likely(record, layout, search.columns, events, at)
        if start is None and turn == 0:
            without = value
        found = search.within(_scaled(record, layout, at), events)
        if found == events:
            break
        events = found
    told = _told(record, layout, search.columns, events, at)
    covariance = _covariance(record, layout, search.columns, events, at)
    return NoiseFit(at[:p], at[p:], covariance, events, told.value - events.costs, without)


def _told(record: CutRecord, layout: Layout, columns: Jumps, events: Events, at: Array) -> Likelihood:
    return likelihood(_scaled(record, layout, at), layout, columns, events)


def _scaled(record: CutRecord, layout: Layout, at: Array) -> CutRecord:
    variance, intensity = np.split(np.exp(at), [record.whole.variance.shape[1]])
    whole = replace(record.whole, variance=record.whole.variance * variance)
    return replace(record, whole=whole, parts=scaled(record.parts, layout, variance, intensity))


def _most_likely(record: CutRecord, layout: Layout, columns: Jumps, events: Events, at: Array) -> tuple[Array, float]:
    def negative(x: Array) -> tuple[float, Array]:
        told = _told(record, layout, columns, events, x)
        return -told.value, -told.slopes

    bounds = [(-_FARTHEST, _FARTHEST)] * len(at)
    found = minimize(negative, at, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40, "ftol": 1e-8})
    return np.asarray(found.x), -float(found.fun)


def _covariance(record: CutRecord, layout: Layout, columns: Jumps, events: Events, at: Array) -> Array:
    """Return the inverse of the curvature there, by differences of slopes; of what is not told, _FARTHEST²."""
    rows = []
    for direction in np.eye(len(at)) * _STEP:
        up, down = (_told(record, layout, columns, events, at + sign * direction) for sign in (1.0, -1.0))
        rows.append((down.slopes - up.slopes) / (2.0 * _STEP))
    sizes, axes = np.linalg.eigh(0.5 * (np.array(rows) + np.array(rows).T))
    return np.asarray((axes / np.maximum(sizes, 1.0 / _FARTHEST**2)) @ axes.T)
