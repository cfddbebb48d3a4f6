"""The smoother over a whole record: a Kalman filter forward, Bryson's and Frazier's adjoint backward.

About a trajectory, the errors ξ (N,) and the samples of a record are linear,

    ξ_{k+1} = Φ_k ξ_k + a_k + N_k w_k,     e_k = C_k ξ_k + v_k,     v_k ~ N(0, R_k)

    forward    ξ̂⁻, P⁻ = S Sᵀ, and of each sample its gain K, innovation e and variance α
    backward   λ ← Φᵀλ,  Λ ← ΦᵀΛΦ;   u = e/α − Kᵀλ,  D = 1/α + KᵀΛK,  λ ← λ + cᵀu,  Λ ← (I − K c)ᵀ Λ (I − K c) + cᵀc/α
    smoothed   ξ̂ = ξ̂⁻ + P⁻λ,   P = P⁻ − P⁻ΛP⁻

(Bierman, 1973). λ and Λ are the score of the likelihood with regard to anything that is added to ξ_k, and its variance.
u and D are those of what is added to a sample (de Jong and Penzer, 1998). So they also tell which jumps and outliers
are likely (`events`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import prod

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.closed_loop import ClosedLoop, closed_loop
from ndob_fmu.runtime.arrays import Array

# Rows that the processor keeps near itself.
NEAR = 1000


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
        both = np.concatenate([S, xi[..., None]], axis=-1)
        for i in range(p):
            if not there[k, i]:
                continue
            R, known = record.variance[k, ..., i], measured[k, ..., i]
            seen = np.matmul(record.rows[k, ..., i, None, :], both)[..., 0, :]
            f = seen[..., :N]
            alpha = np.einsum("...i,...i->...", f, f) + R
            gain = np.matmul(both[..., :N], f[..., None])[..., 0] * (known / alpha)[..., None]
            e = known * (misfit[k, ..., i] - seen[..., N])
            found.gain[k, ..., i, :], found.innovation[k, ..., i] = gain, e
            found.alpha[k, ..., i] = np.where(known, alpha, np.inf)
            f /= (1.0 + np.sqrt(R / alpha))[..., None]
            seen[..., N] = -e
            both -= gain[..., None] * seen[..., None, :]
        if k < K - 1:
            both = np.matmul(record.Phi[k], both)
            xi = both[..., N] + record.shift[k]
            S = lower_factor(np.concatenate([both[..., :N], record.noise[k]], axis=-1))
    return found


def backward(record: LinearRecord, found: Forward, after: tuple[Array, Array] | None = None) -> Adjoint:
    """Return the adjoint of a filtered record.

    after: λ (…,N) and Λ (…,N,N) behind its last samples, where the record goes on
    """
    adjoint = Adjoint(*(np.empty((*found.xi.shape[:-1], *one)) for one in _adjoint_shapes(record)))
    score, variance = after or (np.zeros(1), np.zeros((1, 1)))
    for rows, loop in closed_loops(record, found):
        scores, variances = np.empty_like(loop.of_state), np.empty_like(loop.of_state_variance)
        for k in range(len(scores) - 1, -1, -1):
            scores[k], variances[k] = score, variance
            score, variance = loop.before(k, scores[k], variances[k])
            adjoint.of_state[rows][k], adjoint.of_state_variance[rows][k] = score, variance
        own = np.diagonal(loop.of_samples_variance, axis1=-2, axis2=-1)
        adjoint.of_sample[rows] = loop.of_sample + np.matmul(scores[..., None, :], loop.later)[..., 0, :]
        adjoint.of_sample_variance[rows] = own + (loop.later * np.matmul(variances, loop.later)).sum(axis=-2)
    return adjoint


def through(record: LinearRecord, found: Forward) -> tuple[Array, Array, Array]:
    """Return of a filtered record its closed loop (…,N,N) from the first row behind the last, and λ and Λ before it."""
    last = record.rows.shape[-1]
    closed, score, variance = np.eye(last), np.zeros(last), np.zeros((last, last))
    for _, loop in closed_loops(record, found):
        for k in range(len(loop.Psi) - 1, -1, -1):
            closed = np.matmul(closed, loop.Psi[k])
            score, variance = loop.before(k, score, variance)
    return closed, score, variance


def closed_loops(record: LinearRecord, found: Forward) -> Iterator[tuple[slice, ClosedLoop]]:
    """Yield the closed loop of a filtered record, some rows at once, from the last ones on.

    There is no step from the last one.
    """
    K, several, N = len(record.rows), record.rows.shape[1:-2], record.rows.shape[-1]
    near = max(1, NEAR // max(1, prod(several)))
    for stop in range(K, 0, -near):
        rows = slice(max(stop - near, 0), stop)
        Phi = record.Phi[rows]
        if stop == K:
            Phi = np.concatenate([Phi, np.broadcast_to(np.eye(N), (1, *several, N, N))])
        yield rows, closed_loop(Phi, record.rows[rows], found.gain[rows], found.innovation[rows], found.alpha[rows])


def _adjoint_shapes(record: LinearRecord) -> tuple[tuple[int, ...], ...]:
    p, N = record.rows.shape[-2:]
    return (N,), (N, N), (p,), (p,)


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
