"""A long record as pieces that are filtered side by side: NumPy takes one step of fifty pieces in the time of two.

A piece begins before the rows that it counts for, with a wide covariance, and ends behind them. After so many rows the
filter has forgotten where it began; where it has not, as with parameters that are estimated, the record stays whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smoother import Adjoint, Forward, LinearRecord, backward, forward
from ndob_fmu.runtime.arrays import Array

# Pieces cost a row twice their overlap; so many are worth it.
_MOST_PIECES = 48
# Two neighbours agree at a row up to this part of their standard deviations.
_AGREE = 1e-3
# Where they do not, longer overlaps are tried: still far less than the whole record in one piece.
_LONGER = (1, 2, 4)


@dataclass(frozen=True)
class Pieces:
    """S pieces of L rows each.

    first (S,): the number of their first row
    length: L
    own (S + 1,): piece s counts for the rows own[s] … own[s + 1] − 1
    """

    first: NDArray[np.intp]
    length: int
    own: NDArray[np.intp]

    @property
    def rows(self) -> NDArray[np.intp]:
        """The numbers (L,S) of their rows."""
        return self.first + np.arange(self.length)[:, None]

    def joined(self, parts: Array) -> Array:
        """Return an array (K,…) of one (L,S,…), each row from the piece that counts for it."""
        return np.concatenate([parts[a - first : b - first, s] for s, (first, a, b) in enumerate(self._each())])

    def placed(self, columns: Mapping[int, Array]) -> dict[int, Array]:
        """Return columns (N,c) at some rows as columns (S,N,most c) at the rows of pieces."""
        most = max((one.shape[1] for one in columns.values()), default=0)
        found: dict[int, Array] = {}
        for k, one in columns.items():
            for s in np.flatnonzero((self.first <= k) & (k < self.first + self.length)).tolist():
                local = k - int(self.first[s])
                if local not in found:
                    found[local] = np.zeros((len(self.first), len(one), most))
                found[local][s, :, : one.shape[1]] = one
        return found

    def _each(self) -> list[tuple[int, int, int]]:
        return list(zip(self.first.tolist(), self.own[:-1].tolist(), self.own[1:].tolist(), strict=True))


def cut(K: int, overlap: int) -> Pieces:
    """Return the pieces of K rows, which overlap by twice so many rows."""
    count = max(1, min(_MOST_PIECES, K // max(4 * overlap, 1)))
    own = np.linspace(0, K, count + 1).astype(np.intp)
    length = min(K, int(np.diff(own).max()) + 2 * overlap)
    first = np.clip(own[:-1] - overlap, 0, K - length)
    return Pieces(first, length, own)


def side_by_side(K: int, least: int) -> Pieces:
    """Return pieces of the first rows of K that do not overlap, of at least so many rows where there are enough."""
    count = max(1, min(_MOST_PIECES, K // least))
    own = np.arange(count + 1) * (K // count)
    return Pieces(own[:-1], K // count, own)


@dataclass(frozen=True)
class Known:
    """What the filter finds in the pieces of a record, (L,S,…), with variances (K,p) of its samples and with jumps."""

    variance: Array
    jumps: Mapping[int, Array]
    run: Forward

    def is_with(self, variance: Array, jumps: Mapping[int, Array]) -> bool:
        """Return whether it was found with the same."""
        same = self.jumps.keys() == jumps.keys() and np.array_equal(self.variance, variance)
        return same and all(np.array_equal(one, jumps[k]) for k, one in self.jumps.items())


@dataclass(frozen=True)
class CutRecord:
    """A record and its pieces: what `smoother.forward` and `smoother.backward` find in them, as of the whole record.

    known: what is known of them, which is not found again
    """

    whole: LinearRecord
    pieces: Pieces
    parts: LinearRecord
    known: Known | None = None

    def passes(self, variance: Array, jumps: Mapping[int, Array]) -> tuple[Forward, Adjoint]:
        """Filter the record and return, by row (K,…), what filter and adjoint find.

        variance (K,p): of the samples
        jumps: columns (N,·) that are added to the factor of P⁻ at an instant
        """
        _, run, adjoint = self.passes_of_pieces(variance, jumps)
        return Forward(*_joined(self.pieces, run)), Adjoint(*_joined(self.pieces, adjoint))

    def passes_of_pieces(self, variance: Array, jumps: Mapping[int, Array]) -> tuple[LinearRecord, Forward, Adjoint]:
        """Return the pieces with these variances, and what filter and adjoint find in each, (L,S,…)."""
        told, known = self._told(variance), self.known
        run = known.run if known and known.is_with(variance, jumps) else self._run(told, jumps)
        return told, run, backward(told, run)

    def knowing(self, variance: Array, jumps: Mapping[int, Array]) -> tuple[CutRecord, Forward]:
        """Return it with what the filter finds, and that."""
        run = self._run(self._told(variance), jumps)
        return replace(self, known=Known(variance, jumps, run)), run

    def _told(self, variance: Array) -> LinearRecord:
        return replace(self.parts, variance=variance[self.pieces.rows])

    def _run(self, told: LinearRecord, jumps: Mapping[int, Array]) -> Forward:
        return forward(told, self.pieces.placed(jumps))


def _joined(pieces: Pieces, found: Forward | Adjoint) -> list[Array]:
    return [pieces.joined(getattr(found, one.name)) for one in fields(found)]


def cut_record(
    record: LinearRecord,
    overlap: int,
    wide: Array,
    variance: Array | None = None,
    jumps: Mapping[int, Array] | None = None,
) -> CutRecord:
    """Return a record with its pieces, the whole record as one where a filter forgets its start too slowly.

    overlap: rows after which it has forgotten it
    wide (N,): standard deviations of ξ at the start of a piece
    variance (K,p), jumps: as `CutRecord.passes`, with which it is tried; none: those of the record, and no jumps
    """
    K, told = len(record.rows), record.variance if variance is None else variance
    for longer in _LONGER:
        pieces = cut(K, longer * overlap)
        found = CutRecord(record, pieces, parts_of(record, pieces, wide))
        if len(pieces.first) == 1:
            return found
        found, run = found.knowing(told, jumps or {})
        if _agree(pieces, run):
            return found
    pieces = Pieces(np.zeros(1, dtype=np.intp), K, np.array([0, K]))
    return CutRecord(record, pieces, parts_of(record, pieces, wide))


def parts_of(record: LinearRecord, pieces: Pieces, wide: Array) -> LinearRecord:
    """Return the pieces of a record; all but the first one begin on the trajectory with standard deviations (N,)."""
    rows, steps = pieces.rows, pieces.rows[:-1]
    start, factor = np.zeros((len(pieces.first), len(wide))), np.tile(np.diag(wide), (len(pieces.first), 1, 1))
    start[0], factor[0] = record.start, record.start_factor
    return LinearRecord(
        Phi=record.Phi[steps],
        noise=record.noise[steps],
        shift=record.shift[steps],
        rows=record.rows[rows],
        misfit=record.misfit[rows],
        variance=record.variance[rows],
        start=start,
        start_factor=factor,
    )


def _agree(pieces: Pieces, run: Forward) -> bool:
    """Return whether each piece has forgotten its start when it begins to count."""
    where, numbers = pieces.own[1:-1], np.arange(1, len(pieces.first))
    (before, factor), (after, own_factor) = (
        (run.xi[where - pieces.first[s], s], run.factor[where - pieces.first[s], s]) for s in (numbers - 1, numbers)
    )
    std, own_std = np.linalg.norm(factor, axis=2), np.linalg.norm(own_factor, axis=2)
    apart = np.maximum(np.abs(after - before), np.abs(own_std - std))
    return bool(np.all(apart <= _AGREE * std))
