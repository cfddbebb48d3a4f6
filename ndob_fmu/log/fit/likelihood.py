"""The likelihood L of a record, its slopes and its information about any numbers ψ that the record depends on.

With innovations e and variances α of the samples, and e', α' their slopes by ψ (Gupta and Mehra, 1974),

    L = −½ Σ (log 2πα + e²/α)
    ∂L/∂ψ = Σ (−e'e/α + ½ (α'/α) (e²/α − 1)),     information = Σ (e'e'ᵀ/α + ½ α'α'ᵀ/α²)

These slopes are differences: the filter runs along a record for each ψ that is moved. The record is taken in pieces
that begin with a wide covariance, so that their likelihoods add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.fit.noise_columns import of_each_disturbance
from ndob_fmu.log.smooth.events import Events, Jumps, with_outliers
from ndob_fmu.log.smooth.linear_record import Forward, LinearRecord
from ndob_fmu.log.smooth.pieces import CutRecord
from ndob_fmu.log.smooth.smoother import forward
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.layout import Layout


@dataclass(frozen=True)
class Moved:
    """A record as pieces, and the columns of jumps in it, for one ψ that is moved by `by`."""

    record: CutRecord
    columns: Jumps
    by: float = 0.0

    def filtered(self, events: Events) -> Forward:
        """Return what the filter finds in the pieces (L,S,…), with some events."""
        return forward(self.with_events(events), self.record.pieces.placed(self.columns.at(events.jumps)))

    def values(self, run: Forward) -> Array:
        """Return the log-likelihoods (S,) of the rows of each piece that count."""
        return np.asarray((run.log_likelihoods * self.record.pieces.counts).sum(axis=0))

    def with_events(self, events: Events) -> LinearRecord:
        """Return the pieces with the variances of some outliers."""
        variance = with_outliers(self.record.whole.variance, events)
        return replace(self.record.parts, variance=variance[self.record.pieces.rows])


@dataclass(frozen=True)
class Likelihood:
    """L, and what each sample says of ψ (m,).

    values (S,): L of each piece
    surprise (2p,R): of each output e/√α and (1 − e²/α)/√2, along R rows; without order, and of variance 1 where the
        model is right
    answer (m,2p,R): what ψ does to them
    """

    values: Array
    surprise: Array
    answer: Array

    @property
    def value(self) -> float:
        """L."""
        return float(self.values.sum())

    @property
    def slopes(self) -> Array:
        """∂L/∂ψ (m,)."""
        return -np.asarray(np.einsum("mcr,cr->m", self.answer, self.surprise))

    @property
    def information(self) -> Array:
        """About ψ (m,m)."""
        return np.asarray(np.einsum("acr,bcr->ab", self.answer, self.answer))


def likelihood(centre: Moved, moved: Sequence[Moved], events: Events) -> Likelihood:
    """Return the likelihood of a record with events, and what those say that are moved by one ψ each."""
    run = centre.filtered(events)
    there = np.isfinite(run.alpha) & centre.record.pieces.counts[:, :, None]
    alpha = np.where(there, run.alpha, 1.0)
    std, answer = np.sqrt(alpha), list[Array]()
    e = _in_time(np.where(there, run.innovation, 0.0) / std)
    for one in moved:
        other = one.filtered(events)
        more = np.where(there, other.alpha / alpha - 1.0, 0.0) * np.sqrt(0.5)
        further = _in_time(np.where(there, other.innovation, 0.0) / std)
        answer.append(np.concatenate([further - e, _in_time(more)]) / one.by)
    return Likelihood(
        values=centre.values(run),
        surprise=np.concatenate([e, np.where(_in_time(there), 1.0 - e**2, 0.0) * np.sqrt(0.5)]),
        answer=np.reshape(answer, (len(moved), 2 * len(e), e.shape[1])),
    )


def faster(record: LinearRecord, layout: Layout, intensity: Array) -> LinearRecord:
    """Return a record with factors on the intensities (q2,)."""
    noise = record.noise.copy()
    for columns, factor in zip(of_each_disturbance(noise, layout.q), np.sqrt(intensity).tolist(), strict=True):
        columns *= factor
    return replace(record, noise=noise)


def _in_time(pieces: NDArray[Any]) -> NDArray[Any]:
    """Return numbers (L,S,p) of pieces as (p,R), one piece after the other."""
    return np.asarray(pieces.transpose(2, 1, 0).reshape(pieces.shape[2], -1))
