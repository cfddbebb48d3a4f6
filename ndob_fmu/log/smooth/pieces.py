"""A record as pieces that know nothing of each other, so that their likelihoods add up.

Each begins with a wide covariance about the trajectory, which a small part of its rows forgets.
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


def side_by_side(K: int, least: int) -> Pieces:
    """Return pieces of the first rows of K that do not overlap, of at least so many rows where there are enough."""
    count = max(1, min(_MOST_PIECES, K // least))
    own = np.arange(count + 1) * (K // count)
    return Pieces(own[:-1], K // count, own)


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
