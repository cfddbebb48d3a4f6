"""A record as pieces that know nothing of each other, so that their likelihoods add up.

Each begins with a wide covariance about the trajectory, which a small part of its rows forgets. These rows belong to
the piece before, too, and count there. If they counted here, parameters would look likely that narrow the wide
covariance of the samples: the trajectory knows the samples, so that nothing speaks against them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.linear_record import Adjoint, Forward, LinearRecord
from ndob_fmu.log.smooth.smoother import backward, forward
from ndob_fmu.runtime.arrays import Array

_MOST_PIECES = 48


@dataclass(frozen=True)
class Pieces:
    """S pieces of L rows each.

    first (S,): the number of their first row
    length: L
    begins: rows with which all but the first one begin, and whose likelihood does not count
    """

    first: NDArray[np.intp]
    length: int
    begins: int

    @property
    def own(self) -> NDArray[np.intp]:
        """Where the rows of each piece begin that no piece before it has, and where the last one ends (S + 1,)."""
        return np.concatenate([[0], self.first[1:] + self.begins, [self.first[-1] + self.length]])

    @property
    def rows(self) -> NDArray[np.intp]:
        """The numbers (L,S) of their rows."""
        return self.first + np.arange(self.length)[:, None]

    @property
    def counts(self) -> NDArray[np.bool_]:
        """Which of the rows (L,S) count."""
        counts: NDArray[np.bool_] = np.ones((self.length, len(self.first)), dtype=bool)
        counts[: self.begins, 1:] = False
        return counts

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


def side_by_side(K: int, least: int, begins: int = 0) -> Pieces:
    """Return pieces of the first rows of K, of at least so many rows, with which no other one begins, if there are."""
    begins = min(begins, K // 2)
    count = max(1, min(_MOST_PIECES, (K - begins) // least))
    own = (K - begins) // count
    return Pieces(own * np.arange(count), own + begins, begins)


@dataclass(frozen=True)
class CutRecord:
    """A record in pieces that know nothing of each other, so that their likelihoods add up."""

    whole: LinearRecord
    pieces: Pieces
    parts: LinearRecord

    @property
    def ends(self) -> NDArray[np.intp]:
        """Rows behind which another piece begins."""
        return self.pieces.own[1:-1] - 1

    def begins(self, parts: LinearRecord, run: Forward) -> tuple[LinearRecord, Forward]:
        """Return of filtered pieces the rows that do not count, of all pieces but the first one."""
        rows = slice(self.pieces.begins)
        told = parts.some(rows, parts.start, parts.start_factor)
        record = LinearRecord(
            Phi=told.Phi[:, 1:],
            noise=told.noise[:, 1:],
            shift=told.shift[:, 1:],
            rows=told.rows[:, 1:],
            misfit=told.misfit[:, 1:],
            variance=told.variance[:, 1:],
            start=told.start[1:],
            start_factor=told.start_factor[1:],
        )
        return record, Forward(*(getattr(run, one.name)[rows, 1:] for one in fields(run)))

    def passes(self, variance: Array, jumps: Mapping[int, Array]) -> tuple[Forward, Adjoint]:
        """Filter the pieces and return, by row (K,…), what filter and adjoint find.

        variance (K,p): of the samples
        jumps: columns (N,·) that are added to the factor of P⁻ at an instant
        """
        told = replace(self.parts, variance=variance[self.pieces.rows])
        run = forward(told, self.pieces.placed(jumps))
        adjoint = backward(told, run)
        return Forward(*self._joined(run)), Adjoint(*self._joined(adjoint))

    def _joined(self, found: Forward | Adjoint) -> list[Array]:
        return [self.pieces.joined(getattr(found, one.name)) for one in fields(found)]


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
