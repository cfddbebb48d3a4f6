"""The filter and its adjoint over a whole record, in pieces side by side: NumPy takes one step of many in that of two.

What a piece does to whatever comes in is known from the filter that starts at it with ξ = 0 for sure (Lainiotis, 1976).
With the closed loop A, score b and information C of that filter over the piece, and ξ̂₀, S₀ behind it,

    ξ̂ = ξ̂₀ + A (x + Tᵀ T (b − C x)),     S Sᵀ = S₀ S₀ᵀ + A TᵀT Aᵀ,     TᵀT = F (I + FᵀCF)⁻¹ Fᵀ

for x and P = F Fᵀ that come in. So the starts of all pieces follow one from the other, and each piece is filtered from
its own. The result is that of `smoother.forward` and `smoother.backward`, up to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.c_library import c_library
from ndob_fmu.log.smooth.linear_record import Adjoint, Forward, LinearRecord
from ndob_fmu.log.smooth.smoother import backward, forward, lower_factor, through
from ndob_fmu.runtime.arrays import Array

# A piece costs as much as so many steps of all.
_PIECE_COSTS = 0.25
_LEAST_ROWS = 8


@dataclass(frozen=True)
class WholeRecord:
    """A record that is filtered as a whole, whatever the variances of its samples are and where jumps are in it."""

    whole: LinearRecord

    @property
    def ends(self) -> NDArray[np.intp]:
        """Rows behind which another record begins: none."""
        return np.zeros(0, dtype=np.intp)

    def passes(self, variance: Array, jumps: Mapping[int, Array]) -> tuple[Forward, Adjoint]:
        """Filter the record and return, by row (K,…), what filter and adjoint find.

        variance (K,p): of the samples
        jumps: columns (N,·) that are added to the factor of P⁻ at an instant
        """
        if c_library(len(self.whole.rows)) is not None:
            told = replace(self._short, variance=variance)
            run = forward(told, jumps)
            return run, backward(told, run)
        parts, placed = replace(self._parts, variance=variance[self._numbers]), self._placed(jumps)
        run = forward(parts, placed)
        if self._count > 1:
            parts = _started(parts, run)
            run = forward(parts, placed)
        adjoint = backward(parts, run, _after(parts, run))
        return (
            Forward(*map(self._joined, (run.xi, run.factor, run.gain, run.innovation, run.alpha))),
            Adjoint(*map(self._joined, vars(adjoint).values())),
        )

    @cached_property
    def _short(self) -> LinearRecord:
        """The record with noise of N columns at most."""
        noise = self.whole.noise
        if noise.shape[2] <= self.whole.rows.shape[2]:
            return self.whole
        return replace(self.whole, noise=lower_factor(noise))

    @cached_property
    def _count(self) -> int:
        K = len(self.whole.rows)
        return max(1, min(int((K / _PIECE_COSTS) ** 0.5), K // _LEAST_ROWS))

    @cached_property
    def _length(self) -> int:
        return -(-len(self.whole.rows) // self._count)

    @cached_property
    def _numbers(self) -> NDArray[np.intp]:
        """The number of each row (L + 1,S); the last one of a piece is the first one of the next piece."""
        numbers = np.arange(self._length + 1)[:, None] + self._length * np.arange(self._count)
        return np.asarray(np.minimum(numbers, len(self.whole.rows) - 1))

    @cached_property
    def _parts(self) -> LinearRecord:
        """The pieces, which start with ξ = 0 for sure, but for the first one."""
        record, K, N = self._short, *self.whole.rows.shape[::2]
        numbers = np.arange(self._length + 1)[:, None] + self._length * np.arange(self._count)
        steps, is_step = np.minimum(numbers[:-1], max(K - 2, 0)), numbers[:-1] < K - 1
        misfit = record.misfit[self._numbers]
        misfit[numbers >= K] = np.nan
        misfit[-1] = np.nan
        start, factor = np.zeros((self._count, N)), np.zeros((self._count, N, N))
        start[0], factor[0] = record.start, record.start_factor
        return LinearRecord(
            Phi=np.where(is_step[..., None, None], record.Phi[steps], np.eye(N)),
            noise=record.noise[steps] * is_step[..., None, None],
            shift=record.shift[steps] * is_step[..., None],
            rows=record.rows[self._numbers],
            misfit=misfit,
            variance=record.variance[self._numbers],
            start=start,
            start_factor=factor,
        )

    def _placed(self, jumps: Mapping[int, Array]) -> dict[int, Array]:
        """Return columns (N,·) at some rows as columns (S,N,·) at the rows of pieces."""
        found: dict[int, Array] = {}
        for k, one in jumps.items():
            piece, row = divmod(k, self._length)
            most = max(one.shape[1], found[row].shape[2] if row in found else 0)
            columns = np.zeros((self._count, len(one), most))
            if row in found:
                columns[:, :, : found[row].shape[2]] = found[row]
            columns[piece, :, : one.shape[1]] = one
            found[row] = columns
        return found

    def _joined(self, parts: Array) -> Array:
        """Return an array (K,…) of one (L + 1,S,…)."""
        K = len(self.whole.rows)
        return np.swapaxes(parts[:-1], 0, 1).reshape(-1, *parts.shape[2:])[:K]


def _started(parts: LinearRecord, run: Forward) -> LinearRecord:
    """Return pieces with the starts that follow from what those do that start with ξ = 0 for sure."""
    closed, b, C = through(parts, run)
    N = parts.start.shape[1]
    start, factor = parts.start.copy(), parts.start_factor.copy()
    start[1], factor[1] = run.xi[-1, 0], run.factor[-1, 0]
    for s in range(1, len(start) - 1):
        x, F = start[s], factor[s]
        T = np.linalg.solve(np.linalg.cholesky(np.eye(N) + F.T @ C[s] @ F), F.T)
        start[s + 1] = run.xi[-1, s] + closed[s] @ (x + T.T @ (T @ (b[s] - C[s] @ x)))
        factor[s + 1] = lower_factor(np.concatenate([run.factor[-1, s], closed[s] @ T.T], axis=1))
    return replace(parts, start=start, start_factor=factor)


def _after(parts: LinearRecord, run: Forward) -> tuple[Array, Array]:
    """Return λ (S,N) and Λ (S,N,N) behind each piece."""
    closed, of_score, of_variance = through(parts, run)
    score, variance = np.zeros_like(of_score), np.zeros_like(of_variance)
    for s in range(len(score) - 1, 0, -1):
        score[s - 1] = closed[s].T @ score[s] + of_score[s]
        variance[s - 1] = closed[s].T @ variance[s] @ closed[s] + of_variance[s]
    return score, variance
