"""The scores of a filtered record while events come and go."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.event_effects import AlongRecord, Effect, Source
from ndob_fmu.log.smooth.events import Explained
from ndob_fmu.runtime.arrays import Array

# A change takes as long as a pass over so many rows. Behind more of them another pass is faster.
_ROWS_OF_A_CHANGE = 100
# What is left of I − M where events that explain the same are taken away, at least, to be more than rounding errors.
_LEAST_LEFT = 1e-6
# An event that leaves less than this of a variance is told so well that the scores without it are rounding errors.
_LEAST_TO_TAKE_AWAY = 1e-8


@dataclass(frozen=True)
class Known:
    """An event that the record has: its score s (c,) and I − M (c,c).

    They are followed by themselves: for an event that explains much, M is nearly I.
    """

    source: Source
    score: Array
    left: Array

    @property
    def explains(self) -> float:
        """What the record would lose without it: ½ (sᵀ (I − M)⁻¹ s + log det (I − M)).

        ∞ where it explains so much that of I − M only rounding errors are left.
        """
        try:
            factor = np.linalg.cholesky(self.left)
        except np.linalg.LinAlgError:
            return float(np.inf)
        score = np.linalg.solve(factor, self.score)
        return float(0.5 * score @ score + np.log(np.diag(factor)).sum())

    @property
    def least_left(self) -> float:
        """The least eigenvalue of I − M."""
        return float(self.left[0, 0]) if self.left.size == 1 else float(np.linalg.eigvalsh(self.left)[0])

    def changed(self, covariance: Array, weight: Array, score: Array) -> Known:
        """Return it after a change, with which it has a covariance (c,·)."""
        weighted = covariance @ weight
        return Known(self.source, self.score - weighted @ score, self.left + weighted @ covariance.T)


class KnownOutliers:
    """The outliers that the record has, of which there may be thousands: as `Known`, all of whose numbers are single.

    size (K,p): what one adds to each sample, as standard deviation
    are_there (K,p): which samples have one; score, left (K,p): s and I − M of these
    """

    def __init__(self, size: Array, u: Array, D: Array, outliers: Iterable[tuple[int, int]]) -> None:
        self.size, self.are_there = size, np.zeros(size.shape, dtype=bool)
        for one in outliers:
            self.are_there[one] = True
        self.score = np.where(self.are_there, size * u, 0.0)
        self.left = np.where(self.are_there, 1.0 - size**2 * D, 1.0)

    def source(self, one: tuple[int, int]) -> Source:
        """Return an outlier as an event, whether the record has it or not."""
        return Source(one[0], np.full((1, 1), self.size[one]), one[1])

    def change(self, effect: Effect, weight: Array, score: Array) -> bool:
        """Change those that an event has an effect on; return whether they are known well enough then."""
        rows, which = effect.rows, np.nonzero(self.are_there[effect.rows])
        covariance = self.size[rows][which][:, None] * effect.of_sample[which]
        weighted, before = covariance @ weight, self.left[rows][which]
        after = before + (weighted * covariance).sum(axis=1)
        self.score[rows][which] -= weighted @ score
        self.left[rows][which] = after
        return bool(np.all(after > _LEAST_LEFT * before))


class EventScores:
    """λ, Λ, u and D as in `Adjoint`, and what is known of each event that the record has, jumps and outliers.

    are_known: whether the scores are known well enough to go on
    """

    def __init__(self, found: Explained, jumps: Iterable[Source], size: Array) -> None:
        """size (K,p): what an outlier adds to each sample, as standard deviation."""
        adjoint = found.adjoint
        self.of_state, self.of_state_variance = adjoint.of_state, adjoint.of_state_variance
        self.of_sample, self.of_sample_variance = adjoint.of_sample, adjoint.of_sample_variance
        self._along, self._effects = AlongRecord(found), list[tuple[Effect, Array]]()
        self.are_known, self.jumps = True, dict[int, Known]()
        self.outliers = KnownOutliers(size, self.of_sample, self.of_sample_variance, found.events.outliers)
        for source in jumps:
            score, M = self._of(source)
            self.jumps[source.k] = Known(source, score, np.eye(len(M)) - M)

    def change(self, gone: Sequence[Source], new: Sequence[Source]) -> NDArray[np.intp]:
        """Take away events, then add new ones; return the rows of which the scores change."""
        if (len(self._effects) + len(gone) + len(new)) * _ROWS_OF_A_CHANGE > len(self.of_state):
            self.are_known = False
        if any(self._known(source).least_left < _LEAST_TO_TAKE_AWAY for source in gone):
            self.are_known = False
        if not self.are_known:
            return np.zeros(0, dtype=np.intp)
        if not self._effects:  # so far the scores are those that were found
            self.of_state, self.of_state_variance = self.of_state.copy(), self.of_state_variance.copy()
            self.of_sample, self.of_sample_variance = self.of_sample.copy(), self.of_sample_variance.copy()
        sources = [*gone, *new]
        own = [*map(self._of_gone, gone), *(self._of_new(source)[:2] for source in new)]
        alone = self._along.effects(sources, *zip(*own, strict=True))
        touched = np.zeros(len(self.of_state), dtype=bool)
        for place, source in enumerate(sources):
            effect = alone[place]
            for other, weight in self._effects:  # what it does with those that came before it
                covariance = other.of(source)
                if covariance is not None:
                    effect = effect.less(other, weight @ covariance.T)
            if place < len(gone):
                score, weight = self._of_gone(source)
                self._forget(source)
                self._apply(effect, score, weight)
            else:
                score, weight, left = self._of_new(source)
                self._apply(effect, score, weight)
                self._keep(Known(source, left @ score, left))
            if not self.are_known:
                break
            self._effects.append((effect, weight))
            touched[effect.rows] = True
        return np.flatnonzero(touched)

    def _apply(self, effect: Effect, score: Array, weight: Array) -> None:
        rows, G, g = effect.rows, effect.of_state, effect.of_sample
        weighted = G @ weight
        self.of_state[rows] -= weighted @ score
        self.of_state_variance[rows] -= weighted @ np.swapaxes(G, 1, 2)
        weighted = g @ weight
        self.of_sample[rows] -= weighted @ score
        self.of_sample_variance[rows] -= (weighted * g).sum(axis=2)
        self.are_known = self.outliers.change(effect, weight, score) and self.are_known
        for k, one in self.jumps.items():
            covariance = effect.of(one.source)
            if covariance is not None:
                changed = one.changed(covariance, weight, score)
                self.are_known = self.are_known and changed.least_left > _LEAST_LEFT * one.least_left
                self.jumps[k] = changed

    def _known(self, source: Source) -> Known:
        """Return what is known of an event that the record has."""
        if source.output is None:
            return self.jumps[source.k]
        at, outliers = (source.k, source.output), self.outliers
        return Known(source, outliers.score[at].reshape(1), outliers.left[at].reshape(1, 1))

    def _forget(self, source: Source) -> None:
        if source.output is None:
            del self.jumps[source.k]
        else:
            self.outliers.are_there[source.k, source.output] = False

    def _keep(self, known: Known) -> None:
        source = known.source
        if source.output is None:
            self.jumps[source.k] = known
        else:
            at, outliers = (source.k, source.output), self.outliers
            outliers.are_there[at], outliers.score[at], outliers.left[at] = True, known.score[0], known.left[0, 0]

    def _of_gone(self, source: Source) -> tuple[Array, Array]:
        """Return s_U and W of an event that is taken away."""
        known = self._known(source)
        return known.score, -np.asarray(np.linalg.inv(known.left))

    def _of_new(self, source: Source) -> tuple[Array, Array, Array]:
        """Return s_U and W of an event that is added, and I − M with it, which is the same as W."""
        score, M = self._of(source)
        weight = np.asarray(np.linalg.inv(np.eye(len(M)) + M))
        return score, weight, weight

    def _of(self, source: Source) -> tuple[Array, Array]:
        """Return the score (c,) of an event and its variance (c,c)."""
        k, J = source.k, source.columns
        if source.output is None:
            return J.T @ self.of_state[k], J.T @ self.of_state_variance[k] @ J
        u, D = self.of_sample[k, source.output], self.of_sample_variance[k, source.output]
        return J[0] * u, J.T @ J * D
