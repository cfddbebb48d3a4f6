"""A log as a linear record, and what a filter and a smoother find in it (`smoother` has the equations)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True)
class LinearRecord:
    """A record about a trajectory, K instants; or several records of K instants, which have a second axis then.

    Phi (K-1,…,N,N), noise (K-1,…,N,·), shift (K-1,…,N): Φ, N and a of each step
    rows (K,…,p,N), misfit (K,…,p), variance (K,…,p): C, e and R of each sample; e is NaN where there is none
    start_factor (…,N,N): of the covariance of ξ_0, whose mean is `start` (…,N)
    """

    Phi: Array
    noise: Array
    shift: Array
    rows: Array
    misfit: Array
    variance: Array
    start: Array
    start_factor: Array

    def some(self, rows: slice, start: Array, start_factor: Array) -> LinearRecord:
        """Return the record of some of its instants, with another start."""
        first, stop, _ = rows.indices(len(self.rows))
        steps = slice(first, max(stop - 1, first))
        return LinearRecord(
            Phi=self.Phi[steps],
            noise=self.noise[steps],
            shift=self.shift[steps],
            rows=self.rows[rows],
            misfit=self.misfit[rows],
            variance=self.variance[rows],
            start=start,
            start_factor=start_factor,
        )


@dataclass(frozen=True)
class Forward:
    """What the filter finds.

    xi (K,…,N), factor (K,…,N,N): ξ̂⁻ and S
    gain (K,…,p,N), innovation (K,…,p), alpha (K,…,p): of each sample; 0, 0 and ∞ where there is none
    """

    xi: Array
    factor: Array
    gain: Array
    innovation: Array
    alpha: Array

    @property
    def log_likelihoods(self) -> Array:
        """Of the samples of each instant (K,…)."""
        there = np.isfinite(self.alpha)
        alpha = np.where(there, self.alpha, 1.0)
        each = np.where(there, np.log(2.0 * np.pi * alpha) + self.innovation**2 / alpha, 0.0)
        return np.asarray(-0.5 * each.sum(axis=-1))


@dataclass(frozen=True)
class Adjoint:
    """Scores of the likelihood and their variances.

    of_state (K,…,N), of_state_variance (K,…,N,N): λ and Λ before the samples of an instant
    of_sample (K,…,p), of_sample_variance (K,…,p): u and D; 0 where there is no sample
    """

    of_state: Array
    of_state_variance: Array
    of_sample: Array
    of_sample_variance: Array


@dataclass(frozen=True)
class Smoothed:
    """The smoothed errors, by what filter and adjoint have found. Each is computed when it is first asked for."""

    forward: Forward
    adjoint: Adjoint

    @cached_property
    def xi(self) -> Array:
        """ξ (K,…,N)."""
        S, score = self.forward.factor, self.adjoint.of_state[..., None]
        return np.asarray(self.forward.xi + (S @ (np.swapaxes(S, -1, -2) @ score))[..., 0])

    def some(self, places: slice) -> tuple[Array, Array]:
        """Return some of ξ (K,…,·), and their variances, in less time than all."""
        S, score = self.forward.factor, self.adjoint.of_state
        rows = S[..., places, :]
        P = rows @ np.swapaxes(S, -1, -2)
        left = (rows**2).sum(axis=-1) - (P @ self.adjoint.of_state_variance * P).sum(axis=-1)
        return self.forward.xi[..., places] + (P * score[..., None, :]).sum(axis=-1), np.maximum(left, 0.0)

    @cached_property
    def covariance(self) -> Array:
        """Of ξ (K,…,N,N)."""
        return np.asarray(self._left @ np.swapaxes(self.forward.factor, -1, -2))

    @cached_property
    def std(self) -> Array:
        """Of ξ (K,…,N)."""
        return np.asarray(np.sqrt(np.maximum((self._left * self.forward.factor).sum(axis=-1), 0.0)))

    @cached_property
    def _left(self) -> Array:
        """S (I − Sᵀ Λ S)."""
        S = self.forward.factor
        return np.asarray(S @ (np.eye(S.shape[-1]) - np.swapaxes(S, -1, -2) @ self.adjoint.of_state_variance @ S))
