"""The likelihood L of a record, its slopes and its information about any numbers ψ that the record depends on.

With innovations e and variances α of the samples, and e', α' their slopes by ψ (Gupta and Mehra, 1974),

    L = −½ Σ (log 2πα + e²/α)
    ∂L/∂ψ = Σ (−e'e/α + ½ (α'/α) (e²/α − 1)),     information = Σ (e'e'ᵀ/α + ½ α'α'ᵀ/α²)

The slopes are differences: the filter runs along all records, each moved by one ψ, side by side. The record is taken in
pieces that begin with a wide covariance, so that their likelihoods add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ndob_fmu.log.smooth.events import Events, Jumps, with_outliers
from ndob_fmu.log.smooth.linear_record import LinearRecord
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
    every = [centre, *moved]
    parts = _beside([_told(one.record, events) for one in every])
    placed = [one.record.pieces.placed(one.columns.at(events.jumps)) for one in every]
    run = forward(parts, {k: np.stack([jumps[k] for jumps in placed]) for k in placed[0]})
    there = np.isfinite(run.alpha[:, 0])
    alpha = np.where(np.isfinite(run.alpha), run.alpha, 1.0)
    std, by = np.sqrt(alpha[:, 0]), np.array([one.by for one in moved])[:, None, None]
    e, e_moved = _in_time(run.innovation[:, 0] / std), _of_each(run.innovation[:, 1:] / std[:, None])
    more = np.where(there[:, None], alpha[:, 1:] / alpha[:, :1] - 1.0, 0.0)
    return Likelihood(
        values=np.asarray(run.log_likelihoods[:, 0].sum(axis=0)),
        surprise=np.concatenate([e, np.where(_in_time(there), 1.0 - e**2, 0.0) * np.sqrt(0.5)]),
        answer=np.concatenate([(e_moved - e) / by, _of_each(more) * np.sqrt(0.5) / by], axis=1),
    )


def scaled(record: LinearRecord, layout: Layout, variance: Array, intensity: Array) -> LinearRecord:
    """Return a record with factors on the variances (p,) of samples and on the intensities (q2,)."""
    noise = record.noise.copy()
    by_direction = noise.reshape(*noise.shape[:-1], -1, layout.size)  # the columns of each direction
    by_direction[..., : layout.q, :] *= np.sqrt(intensity)[:, None]
    return replace(record, noise=noise, variance=record.variance * variance)


def _told(record: CutRecord, events: Events) -> LinearRecord:
    return replace(record.parts, variance=with_outliers(record.whole.variance, events)[record.pieces.rows])


def _beside(records: Sequence[LinearRecord]) -> LinearRecord:
    """Return records (L,S,…) side by side (L,V,S,…)."""
    at = {one.name: 0 if one.name in ("start", "start_factor") else 1 for one in fields(LinearRecord)}
    return LinearRecord(**{name: np.stack([getattr(r, name) for r in records], axis=a) for name, a in at.items()})


def _in_time(pieces: Array) -> Array:
    """Return numbers (L,S,p) of pieces as (p,R), one piece after the other."""
    return np.asarray(pieces.transpose(2, 1, 0).reshape(pieces.shape[2], -1))


def _of_each(pieces: Array) -> Array:
    """Return numbers (L,V,S,p) of pieces as (V,p,R)."""
    L, V, S, p = pieces.shape
    return np.asarray(pieces.transpose(1, 3, 2, 0).reshape(V, p, S * L))
