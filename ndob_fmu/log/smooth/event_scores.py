"""The scores of a filtered record while events come and go."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ndob_fmu.log.smooth.event_effects import AlongRecord, Effect, Source
from ndob_fmu.log.smooth.events import Explained
from ndob_fmu.log.smooth.gains import eliminated
from ndob_fmu.runtime.arrays import Array

# What is left of I − M where events that explain the same are taken away, at least, to be more than rounding errors.
_LEAST_LEFT = 1e-6
# An event that leaves less than this of a variance is told so well that the scores without it are rounding errors.
_LEAST_TO_TAKE_AWAY = 1e-8
# A part of the variance of a score that counts where another event is judged.
_COUNTS = 0.01


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
    rows: how many rows have changed, counted for each event that came or went
    """

    def __init__(self, found: Explained, jumps: Iterable[Source], size: Array) -> None:
        """size (K,p): what an outlier adds to each sample, as standard deviation."""
        adjoint = found.adjoint
        self.of_state, self.of_state_variance = adjoint.of_state, adjoint.of_state_variance
        self.of_sample, self.of_sample_variance = adjoint.of_sample, adjoint.of_sample_variance
        self._along, self._effects = AlongRecord(found), list[tuple[Effect, Array]]()
        self.are_known, self.jumps = True, dict[int, Known]()
        self.rows, self._reach = 0, 0
        self.outliers = KnownOutliers(size, self.of_sample, self.of_sample_variance, found.events.outliers)
        for source in jumps:
            score, M = self._of(source)
            self.jumps[source.k] = Known(source, score, np.eye(len(M)) - M)

    @property
    def reach(self) -> float:
        """In how many rows an event that came or went has changed a variance by a part that counts, in the mean."""
        return self._reach / max(len(self._effects), 1)

    def explains(self, source: Source) -> float:
        """Return what an event explains: one that the record has, or another one."""
        if self._has(source):
            return self._known(source).explains
        score, M = self._of(source)
        return float(eliminated(score[None], M[None])[0])

    def take_away(self, source: Source) -> slice:
        """Take away an event; return the rows of which the scores change."""
        known = self._known(source)
        if known.least_left < _LEAST_TO_TAKE_AWAY:
            self.are_known = False
            return slice(0)
        weight = -np.asarray(np.linalg.inv(known.left))
        effect = self._effect(source, known.score, weight)
        self._forget(source)
        return self._apply(effect, known.score, weight)

    def add(self, source: Source) -> slice:
        """Add an event; return the rows of which the scores change."""
        score, M = self._of(source)
        weight = np.asarray(np.linalg.inv(np.eye(len(M)) + M))  # and I − M with it
        rows = self._apply(self._effect(source, score, weight), score, weight)
        self._keep(Known(source, weight @ score, weight))
        return rows

    def _effect(self, source: Source, score: Array, weight: Array) -> Effect:
        """Return what an event does to the scores as they are by now."""
        (alone,) = self._along.effects([source], [score], [weight])
        others = [(one, own @ covariance.T) for one, own in self._effects if (covariance := one.of(source)) is not None]
        return alone.less(others)

    def _apply(self, effect: Effect, score: Array, weight: Array) -> slice:
        if not self._effects:  # so far the scores are those that were found
            self.of_state, self.of_state_variance = self.of_state.copy(), self.of_state_variance.copy()
            self.of_sample, self.of_sample_variance = self.of_sample.copy(), self.of_sample_variance.copy()
        self._effects.append((effect, weight))
        rows, G, g = effect.rows, effect.of_state, effect.of_sample
        weighted = G @ weight
        counts = np.abs((weighted * G).sum(axis=2)) > _COUNTS * self.of_state_variance[rows].diagonal(axis1=1, axis2=2)
        self.rows, self._reach = self.rows + len(G), self._reach + int(np.count_nonzero(counts.any(axis=1)))
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
        return rows

    def _has(self, source: Source) -> bool:
        if source.output is None:
            known = self.jumps.get(source.k)
            return known is not None and known.source.columns.shape == source.columns.shape
        return bool(self.outliers.are_there[source.k, source.output])

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

    def _of(self, source: Source) -> tuple[Array, Array]:
        """Return the score (c,) of an event and its variance (c,c)."""
        k, J = source.k, source.columns
        if source.output is None:
            return J.T @ self.of_state[k], J.T @ self.of_state_variance[k] @ J
        u, D = self.of_sample[k, source.output], self.of_sample_variance[k, source.output]
        return J[0] * u, J.T @ J * D
