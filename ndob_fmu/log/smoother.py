"""The smoother over a whole record: a Kalman filter forward, Bryson's and Frazier's adjoint backward.

About a trajectory, the errors ξ (N,) and the samples of a record are linear,

    ξ_{k+1} = Φ_k ξ_k + a_k + N_k w_k,     e_k = C_k ξ_k + v_k,     v_k ~ N(0, R_k)

    forward    ξ̂⁻, P⁻ = S Sᵀ, and of each sample its gain K, innovation e and variance α
    backward   u = e/α − Kᵀλ,  D = 1/α + KᵀΛK,  λ ← λ + cᵀu,  Λ ← (I − K c)ᵀ Λ (I − K c) + cᵀc/α;   λ ← Φᵀλ,  Λ ← ΦᵀΛΦ
    smoothed   ξ̂ = ξ̂⁻ + P⁻λ,   P = P⁻ − P⁻ΛP⁻

(Bierman, 1973). λ and Λ are the score of the likelihood with regard to anything that is added to ξ_k, and its variance.
u and D are those of what is added to a sample (de Jong and Penzer, 1998). So they also tell which jumps and outliers
are likely (`events`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

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
    """The smoothed errors ξ (K,…,N), and their covariances (K,…,N,N)."""

    xi: Array
    covariance: Array


def forward(record: LinearRecord, jumps: Mapping[int, Array] | None = None) -> Forward:
    """Filter a record.

    jumps: columns (…,N,·) that are added to the factor of P⁻ at an instant
    """
    K, added = len(record.rows), jumps or {}
    several, (p, N) = record.rows.shape[1:-2], record.rows.shape[-2:]
    found = Forward(
        xi=np.empty((K, *several, N)),
        factor=np.empty((K, *several, N, N)),
        gain=np.zeros((K, *several, p, N)),
        innovation=np.zeros((K, *several, p)),
        alpha=np.full((K, *several, p), np.inf),
    )
    measured: NDArray[np.bool_] = np.asarray(np.isfinite(record.misfit))
    there, misfit = measured.reshape(K, -1, p).max(axis=1), np.where(measured, record.misfit, 0.0)
    xi, S = record.start, record.start_factor
    for k in range(K):
        if k in added:
            S = lower_factor(np.concatenate([S, added[k]], axis=-1))
        found.xi[k], found.factor[k] = xi, S
        for i in range(p):
            if not there[k, i]:
                continue
            c, R, known = record.rows[k, ..., i, :], record.variance[k, ..., i], measured[k, ..., i]
            f = np.matmul(c[..., None, :], S)[..., 0, :]
            alpha = (f * f).sum(axis=-1) + R
            gain = np.matmul(S, f[..., None])[..., 0] * (known / alpha)[..., None]
            e = known * (misfit[k, ..., i] - (c * xi).sum(axis=-1))
            xi = xi + gain * e[..., None]
            S = S - (gain / (1.0 + np.sqrt(R / alpha))[..., None])[..., :, None] * f[..., None, :]
            found.gain[k, ..., i, :], found.innovation[k, ..., i] = gain, e
            found.alpha[k, ..., i] = np.where(known, alpha, np.inf)
        if k < K - 1:
            xi = np.matmul(record.Phi[k], xi[..., None])[..., 0] + record.shift[k]
            S = lower_factor(np.concatenate([record.Phi[k] @ S, record.noise[k]], axis=-1))
    return found


def backward(record: LinearRecord, found: Forward) -> Adjoint:
    """Return the adjoint of a filtered record."""
    K = len(record.rows)
    several, (p, N) = record.rows.shape[1:-2], record.rows.shape[-2:]
    of_state, of_variance = np.empty((K, *several, N)), np.empty((K, *several, N, N))
    u, D = np.zeros((K, *several, p)), np.zeros((K, *several, p))
    score, variance = np.zeros((*several, N)), np.zeros((*several, N, N))
    measured: NDArray[np.bool_] = np.asarray(np.isfinite(found.alpha))
    there, per_alpha = measured.reshape(K, -1, p).max(axis=1), 1.0 / found.alpha
    for k in range(K - 1, -1, -1):
        for i in range(p - 1, -1, -1):
            if not there[k, i]:
                continue
            known, gain = measured[k, ..., i], found.gain[k, ..., i, :]
            c = record.rows[k, ..., i, :] * known[..., None]
            seen = np.matmul(variance, gain[..., None])[..., 0]
            u[k, ..., i] = found.innovation[k, ..., i] * per_alpha[k, ..., i] - (gain * score).sum(axis=-1)
            D[k, ..., i] = per_alpha[k, ..., i] + (gain * seen).sum(axis=-1)
            score = score + c * u[k, ..., i, None]
            across = c[..., :, None] * (0.5 * D[k, ..., i, None] * c - seen)[..., None, :]
            variance = variance + across + np.swapaxes(across, -1, -2)
        of_state[k], of_variance[k] = score, variance
        if k:
            back = np.swapaxes(record.Phi[k - 1], -1, -2)
            score = np.matmul(back, score[..., None])[..., 0]
            variance = back @ variance @ record.Phi[k - 1]
    return Adjoint(of_state, of_variance, u, D)


def smoothed(found: Forward, adjoint: Adjoint) -> Smoothed:
    """Return the smoothed errors of a record."""
    S, St = found.factor, np.swapaxes(found.factor, -1, -2)
    xi = found.xi + (S @ (St @ adjoint.of_state[..., None]))[..., 0]
    covariance = S @ (np.eye(S.shape[-1]) - St @ adjoint.of_state_variance @ S) @ St
    return Smoothed(xi, covariance)


def lower_factor(rows: Array) -> Array:
    """Return lower triangles T (…,m,m) with T Tᵀ = rows rowsᵀ, for rows (…,m,·)."""
    m, columns = rows.shape[-2:]
    if columns < m:
        rows = np.concatenate([rows, np.zeros((*rows.shape[:-1], m - columns))], axis=-1)
    reflected = np.linalg.qr(np.swapaxes(rows, -1, -2), mode="raw")[0]
    return np.where(_lower(m), reflected[..., :m], 0.0)


@lru_cache(maxsize=16)
def _lower(m: int) -> NDArray[np.bool_]:
    return np.tri(m, dtype=bool)
