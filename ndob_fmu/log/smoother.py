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
from math import log, pi, sqrt

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.kalman import triangular


@dataclass(frozen=True)
class LinearRecord:
    """A record about a trajectory, K instants.

    Phi (K-1,N,N), noise (K-1,N,N), shift (K-1,N): Φ, N and a of each step
    rows (K,p,N), misfit (K,p), variance (K,p): C, e and R of each sample; e is NaN where there is none
    start_factor (N,N): of the covariance of ξ_0, whose mean is `start` (N,)
    """

    Phi: Array
    noise: Array
    shift: Array
    rows: Array
    misfit: Array
    variance: Array
    start: Array
    start_factor: Array


@dataclass(frozen=True)
class Forward:
    """What the filter finds.

    xi (K,N), factor (K,N,N): ξ̂⁻ and S
    gain (K,p,N), innovation (K,p), alpha (K,p): of each sample; 0, 0 and ∞ where there is none
    log_likelihood: of all innovations
    """

    xi: Array
    factor: Array
    gain: Array
    innovation: Array
    alpha: Array
    log_likelihood: float


@dataclass(frozen=True)
class Adjoint:
    """Scores of the likelihood and their variances.

    of_state (K,N), of_state_variance (K,N,N): λ and Λ before the samples of an instant
    after (K,N), after_variance (K,N,N): λ and Λ behind them
    of_sample (K,p), of_sample_variance (K,p): u and D; 0 where there is no sample
    """

    of_state: Array
    of_state_variance: Array
    after: Array
    after_variance: Array
    of_sample: Array
    of_sample_variance: Array


@dataclass(frozen=True)
class Smoothed:
    """The smoothed errors ξ (K,N), and factors (K,N,N) of their covariances."""

    xi: Array
    covariance: Array


def forward(record: LinearRecord, jumps: Mapping[int, Array] | None = None) -> Forward:
    """Filter a record.

    jumps: columns (N,·) that are added to the factor of P⁻ at an instant
    """
    (K, p, N), added = record.rows.shape, jumps or {}
    xis, factors, gains = np.empty((K, N)), np.empty((K, N, N)), np.zeros((K, p, N))
    innovations, alphas = np.zeros((K, p)), np.full((K, p), np.inf)
    xi, S, total = record.start, record.start_factor, 0.0
    measured = np.isfinite(record.misfit)
    for k in range(K):
        if k in added:
            S = triangular(np.concatenate([S, added[k]], axis=1))
        xis[k], factors[k] = xi, S
        for i in range(p):
            if not measured[k, i]:
                continue
            c, R = record.rows[k, i], float(record.variance[k, i])
            f = c @ S
            alpha = float(f @ f) + R
            gain, e = (S @ f) / alpha, float(record.misfit[k, i] - c @ xi)
            xi = xi + gain * e
            S = S - (gain / (1.0 + sqrt(R / alpha)))[:, None] * f
            gains[k, i], innovations[k, i], alphas[k, i] = gain, e, alpha
            total -= 0.5 * (log(2.0 * pi * alpha) + e * e / alpha)
        if k < K - 1:
            xi = record.Phi[k] @ xi + record.shift[k]
            S = triangular(np.concatenate([record.Phi[k] @ S, record.noise[k]], axis=1))
    return Forward(xis, factors, gains, innovations, alphas, total)


def backward(record: LinearRecord, found: Forward) -> Adjoint:
    """Return the adjoint of a filtered record."""
    K, p, N = record.rows.shape
    before, before_variance = np.empty((K, N)), np.empty((K, N, N))
    after, after_variance = np.empty((K, N)), np.empty((K, N, N))
    u, D = np.zeros((K, p)), np.zeros((K, p))
    score, variance = np.zeros(N), np.zeros((N, N))
    measured = np.isfinite(found.alpha)
    for k in range(K - 1, -1, -1):
        after[k], after_variance[k] = score, variance
        for i in range(p - 1, -1, -1):
            if not measured[k, i]:
                continue
            c, gain, alpha = record.rows[k, i], found.gain[k, i], found.alpha[k, i]
            seen = variance @ gain
            u[k, i], D[k, i] = found.innovation[k, i] / alpha - gain @ score, 1.0 / alpha + gain @ seen
            score = score + c * u[k, i]
            across = c[:, None] * (0.5 * D[k, i] * c - seen)
            variance = variance + across + across.T
        before[k], before_variance[k] = score, variance
        if k:
            score = score @ record.Phi[k - 1]
            variance = record.Phi[k - 1].T @ variance @ record.Phi[k - 1]
    return Adjoint(before, before_variance, after, after_variance, u, D)


def smoothed(found: Forward, adjoint: Adjoint) -> Smoothed:
    """Return the smoothed errors of a record."""
    S, St = found.factor, np.swapaxes(found.factor, 1, 2)
    xi = found.xi + np.einsum("kij,kj->ki", S, np.einsum("kji,kj->ki", S, adjoint.of_state))
    covariance = S @ (np.eye(S.shape[1]) - St @ adjoint.of_state_variance @ S) @ St
    return Smoothed(xi, covariance)
