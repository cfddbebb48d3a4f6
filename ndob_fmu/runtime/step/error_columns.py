"""Columns that corrections and steps change as they change the error of ξ̂, side by side in one matrix.

    [S, μ, v]      S: factor of the covariance, μ: signatures of jumps, v: covariance with disturbances of the past

A correction with the gain K and the row h takes K (h ·) from each of them, a step multiplies each by Φ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.arrays import Array


@dataclass(slots=True)  # never changed once made; frozen=True would make that cost a hundredth of a step
class ErrorColumns:
    """The columns (rows,·); `factor_count` of S, `jump_count` of μ, and the rest of v."""

    values: Array
    factor_count: int
    jump_count: int

    @property
    def factor(self) -> Array:
        """S (rows,·)."""
        return self.values[:, : self.factor_count]

    @property
    def signatures(self) -> Array:
        """μ (rows,·)."""
        return self.values[:, self.factor_count : self.factor_count + self.jump_count]

    @property
    def covariance(self) -> Array:
        """v (rows,·)."""
        return self.values[:, self.factor_count + self.jump_count :]

    def with_values(self, values: Array) -> ErrorColumns:
        """Return other columns of the same counts."""
        return ErrorColumns(values, self.factor_count, self.jump_count)

    def with_factor(self, factor: Array) -> ErrorColumns:
        """Return the columns with another factor (rows,·)."""
        values = np.concatenate([factor, self.values[:, self.factor_count :]], axis=1)
        return ErrorColumns(values, factor.shape[1], self.jump_count)

    def with_signatures(self, signatures: Array) -> ErrorColumns:
        """Return the columns with other signatures, of the same count."""
        return joined(self.factor, signatures, self.covariance)

    def with_past(self, d: slice) -> ErrorColumns:
        """Return the columns with the covariance of the disturbance, whose rows are `d`, in place of the oldest one."""
        factor = self.factor
        newest = factor @ factor[d].T
        return joined(factor, self.signatures, np.concatenate([self.covariance[:, newest.shape[1] :], newest], axis=1))

    def with_room(self, count: int) -> ErrorColumns:
        """Return the columns with so many more of the factor, which are zero."""
        start = self.factor_count
        values = np.zeros((len(self.values), self.values.shape[1] + count))
        values[:, :start], values[:, start + count :] = self.values[:, :start], self.values[:, start:]
        return ErrorColumns(values, start + count, self.jump_count)

    def more(self, columns: Array) -> ErrorColumns:
        """Return the columns with more of the factor."""
        return self.with_factor(np.concatenate([self.factor, columns], axis=1))


def joined(factor: Array, signatures: Array, covariance: Array) -> ErrorColumns:
    """Return columns side by side."""
    values = np.concatenate([factor, signatures, covariance], axis=1)
    return ErrorColumns(values, factor.shape[1], signatures.shape[1])
