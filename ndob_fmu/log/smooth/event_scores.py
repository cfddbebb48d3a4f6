"""The scores of a filtered record while events come and go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.event_effects import AlongRecord, Effect, Source
from ndob_fmu.log.smooth.events import Explained
from ndob_fmu.runtime.arrays import Array

# An instant and the output of an outlier, None for a jump.
Event = tuple[int, int | None]
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


class EventScores:
    """λ, Λ, u and D as in `Adjoint`, and what is known of each event; `sources`: of those the record has.

    are_known: whether the scores are known well enough to go on
    """

    def __init__(self, found: Explained, sources: Mapping[Event, Source]) -> None:
        adjoint = found.adjoint
        self.of_state, self.of_state_variance = adjoint.of_state, adjoint.of_state_variance
        self.of_sample, self.of_sample_variance = adjoint.of_sample, adjoint.of_sample_variance
        self._along, self._effects = AlongRecord(found), list[tuple[Effect, Array]]()
        self.are_known, self.known = True, dict[Event, Known]()
        for which, source in sources.items():
            score, M = self._of(source)
            self.known[which] = Known(source, score, np.eye(len(M)) - M)

    def change(self, gone: list[Event], new: Mapping[Event, Source]) -> NDArray[np.intp]:
        """Take away events, then add new ones; return the rows of which the scores change."""
        if (len(self._effects) + len(gone) + len(new)) * _ROWS_OF_A_CHANGE > len(self.of_state):
            self.are_known = False
        if any(self.known[which].least_left < _LEAST_TO_TAKE_AWAY for which in gone):
            self.are_known = False
        if not self.are_known:
            return np.zeros(0, dtype=np.intp)
        if not self._effects:  # so far the scores are those that were found
            self.of_state, self.of_state_variance = self.of_state.copy(), self.of_state_variance.copy()
            self.of_sample, self.of_sample_variance = self.of_sample.copy(), self.of_sample_variance.copy()
        sources = [*(self.known[which].source for which in gone), *new.values()]
        own = [*(self._of_gone(which) for which in gone), *(self._of_new(source)[:2] for source in new.values())]
        alone = self._along.effects(sources, *zip(*own, strict=True))
        touched = np.zeros(len(self.of_state), dtype=bool)
        for place, (which, source) in enumerate(zip([*gone, *new], sources, strict=True)):
            effect = alone[place]
            for other, weight in self._effects:  # what it does with those that came before it
                covariance = other.of(source)
                if covariance is not None:
                    effect = effect.less(other, weight @ covariance.T)
            if place < len(gone):
                score, weight = self._of_gone(which)
                del self.known[which]
                self._apply(effect, score, weight)
            else:
                score, weight, left = self._of_new(source)
                self._apply(effect, score, weight)
                self.known[which] = Known(source, left @ score, left)
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
        near = [(which, one) for which, one in self.known.items() if rows.start <= one.source.k < rows.stop]
        outliers = [(which, one) for which, one in near if one.source.output is not None]
        jumps = [(which, one) for which, one in near if one.source.output is None]
        changed = _changed_outliers(effect, [one for _, one in outliers], weight, score)
        for _, one in jumps:
            covariance = one.source.columns.T @ effect.of_state[one.source.k - effect.first]
            changed.append(one.changed(covariance, weight, score))
        for (which, one), other in zip([*outliers, *jumps], changed, strict=True):
            self.are_known = self.are_known and other.least_left > _LEAST_LEFT * one.least_left
            self.known[which] = other

    def _of_gone(self, which: Event) -> tuple[Array, Array]:
        """Return s_U and W of an event that is taken away."""
        known = self.known[which]
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


def _changed_outliers(effect: Effect, outliers: list[Known], weight: Array, score: Array) -> list[Known]:
    """Return outliers at rows of an effect as `Known.changed`, all at once: there may be hundreds."""
    if not outliers:
        return []
    at = [(one.source.k - effect.first, one.source.output) for one in outliers]
    size, scores, left = (
        np.array(column)
        for column in zip(*((one.source.columns[0], one.score, one.left[0]) for one in outliers), strict=True)
    )
    covariance = size * effect.of_sample[tuple(np.array(at).T)]
    weighted = covariance @ weight
    scores, left = scores - (weighted @ score)[:, None], left + (weighted * covariance).sum(axis=1, keepdims=True)
    return [Known(one.source, s, r) for one, s, r in zip(outliers, scores, left[:, None], strict=True)]
