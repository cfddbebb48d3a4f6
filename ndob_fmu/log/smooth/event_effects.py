"""What a jump or an outlier does to the scores of a filtered record, without filtering it again.

An event adds columns U to what the samples may do, Σ' = Σ + U Uᵀ for their covariance Σ. For any scores s = AᵀΣ⁻¹y,
with those of the event, s_U = UᵀΣ⁻¹y of variance M, and the covariance G of both,

    s' = s − G W s_U,     var s' = var s − G W Gᵀ,     W = (I + M)⁻¹

and W = −(I − M)⁻¹ where an event that is there is taken away. Along the record G follows from the filter's closed loop,
Ψ_k = Φ_k (I − K_k C_k): from an event's own instant forwards the columns move as a ← Ψ a with G = Λ a, backwards as
G ← Ψᵀ G. It ends where the filter has forgotten, so that an event costs some rows around it only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.c_library import FollowedEvents, c_library
from ndob_fmu.log.smooth.closed_loop import closed_loop
from ndob_fmu.log.smooth.events import Explained
from ndob_fmu.runtime.arrays import Array

# Rows that are taken at once, and the part of a variance that an event changes where it is forgotten. What a filter
# forgets in no time, it also hardly knows; there the next pass tells the rest. Filters of `fit` forget within a piece.
_ROWS, _MOST_ROWS = 64, 2048
_FORGOTTEN = 1e-12


@dataclass(frozen=True)
class Source:
    """An event at an instant k: columns (N,c) that it adds to ξ_k, or what it adds to sample `output`, (1,1)."""

    k: int
    columns: Array
    output: int | None = None


@dataclass(frozen=True)
class Effect:
    """The covariances G of the scores with that of an event, from the row `first` on.

    of_state (R,N,c): of λ; of_sample (R,p,c): of u
    """

    first: int
    of_state: Array
    of_sample: Array

    @property
    def rows(self) -> slice:
        """The rows of the record."""
        return slice(self.first, self.first + len(self.of_state))

    def of(self, source: Source) -> Array | None:
        """Return Cov (·,c) of the score of another event with this one; None where it is forgotten there."""
        k = source.k - self.first
        if not 0 <= k < len(self.of_state):
            return None
        if source.output is None:
            return np.asarray(source.columns.T @ self.of_state[k])
        return np.asarray(source.columns.T * self.of_sample[k, source.output])

    def less(self, others: Sequence[tuple[Effect, Array]]) -> Effect:
        """Return it less other ones, each times a matrix, where both are known."""
        of_state, of_sample = self.of_state.copy(), self.of_sample.copy()
        for other, by in others:
            first, stop = max(self.first, other.first), min(self.rows.stop, other.rows.stop)
            mine, theirs = (slice(first - one.first, stop - one.first) for one in (self, other))
            of_state[mine] -= other.of_state[theirs] @ by
            of_sample[mine] -= other.of_sample[theirs] @ by
        return Effect(self.first, of_state, of_sample)


@dataclass(frozen=True)
class _Loop:
    """The filter's closed loop at rows (…).

    Psi (…,N,N): Ψ
    earlier (…,N,p): Cov(λ, u) at the row
    later (…,N,p): what of a unit of u stands behind the step, as columns of an event do
    samples (…,p,p): Cov(u, u) at the row
    """

    Psi: Array
    earlier: Array
    later: Array
    samples: Array


class AlongRecord:
    """The closed loop of a filter along a record, from which the effects of events follow."""

    def __init__(self, found: Explained) -> None:
        self._record, self._found, self._adjoint = found.record, found.forward, found.adjoint
        self._goes_on = np.ones(len(found.record.rows))
        self._goes_on[[*found.ends, -1]] = 0.0

    def effects(self, sources: Sequence[Source], scores: Sequence[Array], weights: Sequence[Array]) -> list[Effect]:
        """Return the effects of events, each as if it came alone; s_U (c,) and W (c,c) tell where they end."""
        k = np.array([one.k for one in sources])
        each = [one.columns.shape[1] for one in sources]
        E, most, N = len(sources), max(each), self._record.rows.shape[2]
        at, variance = self._at(k), self._adjoint.of_state_variance[k]
        columns, score, weight = np.zeros((E, N, most)), np.zeros((E, most)), np.zeros((E, most, most))
        G, g, a = np.zeros((E, N, most)), np.zeros((E, self._record.rows.shape[1], most)), np.zeros((E, N, most))
        for e, (one, c) in enumerate(zip(sources, each, strict=True)):
            score[e, :c], weight[e, :c, :c] = scores[e], weights[e]
            if one.output is None:
                columns[e, :, :c] = one.columns
            else:
                i, size = one.output, one.columns
                G[e, :, :c], g[e, :, :c] = at.earlier[e, :, i, None] * size, at.samples[e, :, i, None] * size
                a[e, :, :c] = at.later[e, :, i, None] * size
        G += variance @ columns
        g += np.swapaxes(at.earlier, 1, 2) @ columns
        a += at.Psi @ columns
        before = self._along(k, -1, G, score, weight)
        after = self._along(k, 1, a, score, weight)
        return [
            Effect(
                int(k[e]) - len(before[e][0]),
                *(np.concatenate([b[::-1, :, :c], own[e, None, :, :c], f[:, :, :c]])
                  for b, own, f in zip(before[e], (G, g), after[e], strict=True)),
            )
            for e, c in enumerate(each)
        ]  # fmt: skip

    def _along(self, k: NDArray[np.intp], way: int, x: Array, score: Array, weight: Array) -> list[tuple[Array, Array]]:
        """Return G and g of events from the rows beside theirs on, forwards or backwards, until they have no effect.

        x (E,N,c): the columns behind the first step forwards, G of the event's own row backwards
        """
        most, K = min(len(self._record.rows), _MOST_ROWS), len(self._record.rows)
        in_c = c_library(K)
        if in_c is not None:
            told = FollowedEvents(k, x, score, weight, most, _ROWS, _FORGOTTEN)
            variances = self._adjoint.of_state_variance
            return in_c.effects(self._record, self._found, variances, self._goes_on, told, way)
        parts, reach = [list[tuple[Array, Array]]() for _ in k], np.zeros(len(k), dtype=int)
        left = np.arange(len(k))  # those that still have an effect
        for done in range(0, most, _ROWS):
            rows = k[left, None] + way * np.arange(done + 1, done + _ROWS + 1)
            at, there = self._at(np.clip(rows, 0, K - 1)), (rows >= 0)[..., None, None]
            states = np.empty((*rows.shape, *x.shape[1:]))
            Psi = at.Psi if way > 0 else np.swapaxes(at.Psi * there, 2, 3)
            for r in range(_ROWS):
                states[:, r] = x  # columns before the row, or G behind it
                x = Psi[:, r] @ x
            variance = self._adjoint.of_state_variance[np.clip(rows, 0, K - 1)]
            if way > 0:
                G, g = variance @ states, np.swapaxes(at.earlier, 2, 3) @ states
            else:
                G, g = Psi @ states, np.swapaxes(at.later * there, 2, 3) @ states
            for e, part in zip(left.tolist(), zip(G, g, strict=True), strict=True):
                parts[e].append(part)
            counts = _counts(G, variance, score[left], weight[left])
            last = np.where(counts.any(axis=1), _ROWS - np.argmax(counts[:, ::-1], axis=1), 0)
            reach[left] = np.where(last > 0, done + last, reach[left])
            goes_on = last > _ROWS // 2
            left, x = left[goes_on], x[goes_on]
            if not len(left):
                break
        each = [[np.concatenate(one) for one in zip(*some, strict=True)] for some in parts]
        return [(G[:stop], g[:stop]) for (G, g), stop in zip(each, reach.tolist(), strict=True)]

    def _at(self, rows: NDArray[np.intp]) -> _Loop:
        record, found, last = self._record, self._found, len(self._record.rows) - 1
        goes_on = self._goes_on[rows, None, None]
        Phi = record.Phi[np.minimum(rows, last - 1)] * goes_on
        loop = closed_loop(Phi, record.rows[rows], found.gain[rows], found.innovation[rows], found.alpha[rows])
        behind = self._adjoint.of_state_variance[np.minimum(rows + 1, last)] @ loop.later
        return _Loop(
            Psi=loop.Psi,
            earlier=loop.earlier + np.swapaxes(loop.Psi, -1, -2) @ behind,
            later=loop.later,
            samples=loop.of_samples_variance + np.swapaxes(loop.later, -1, -2) @ behind,
        )


def _counts(G: Array, variance: Array, score: Array, weight: Array) -> NDArray[np.bool_]:
    """Return at which rows (E,R) events change λ or its variance noticeably."""
    least = _FORGOTTEN * np.diagonal(variance, axis1=2, axis2=3)
    weighted = G @ weight[:, None]
    in_score = (weighted @ score[:, None, :, None])[..., 0]
    in_variance = np.abs((weighted * G).sum(axis=3))
    return np.asarray(((in_score**2 > least) | (in_variance > least)).any(axis=2))
