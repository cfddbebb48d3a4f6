"""One step of ξ' = F ξ + g w with white noise w: its transition and a factor of the noise's covariance.

    Φ = e^{FH},   N Nᵀ = ∫₀ᴴ e^{Ft} g gᵀ e^{Fᵀt} dt

The noise over a short step is Σ_k F^k g/k! I_k with I_k = ∫₀ᴴ (H − t)^k dw. The covariance of the I_k is
H^{j+k+1}/(j + k + 1), a Hilbert matrix, whose Cholesky factor is known in closed form. So N is computed without a
difference of large numbers, and keeps the digits of its small entries (H^{k+1/2}) as Van Loan's formula does not.
Longer steps are joined from two halves, N = [N_h, Φ_h N_h].
"""

from __future__ import annotations

from math import ceil, factorial, log2

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.exponential import exponential
from ndob_fmu.runtime.numerics.kalman import triangular

# With ‖F h‖ ≤ 1/2 the terms left out are below 1e-12 of the first one.
_TERMS = 11
_RADIUS = 0.5
_MOST_DOUBLINGS = 64


def _series_weights() -> Array:
    """Return the Cholesky factor of the Hilbert matrix (terms,terms), row k divided by k!."""
    weights = np.zeros((_TERMS, _TERMS))
    for k in range(_TERMS):
        for j in range(k + 1):
            entry = np.sqrt(2.0 * j + 1.0) * factorial(k) ** 2 / (factorial(k - j) * factorial(k + j + 1))
            weights[k, j] = entry / factorial(k)
    return weights


_WEIGHTS = _series_weights()


def sampled(F: Array, channel: Array, H: float) -> tuple[Array, Array]:
    """Return Φ (N,N) and N (N,·) of a step H > 0 s, for F (N,N) and a channel g (N,g).

    The number of columns of N depends on ‖F‖ H only by whether that exceeds 1/2.
    """
    size = float(np.max(np.sum(np.abs(F), axis=0))) * H
    doublings = min(max(0, ceil(log2(size / _RADIUS))), _MOST_DOUBLINGS) if size > _RADIUS else 0
    h = H / 2.0**doublings
    Phi, noise = exponential(F * h), _short(F, channel, h)
    for _ in range(doublings):
        noise = triangular(np.hstack([noise, Phi @ noise, np.zeros_like(F)]))
        Phi = Phi @ Phi
    return Phi, noise


def responses(F: Array, channel: Array, durations: list[float]) -> list[Array]:
    """Return e^{Ft} g (N,g) for each of the durations t > 0 (s)."""
    if float(np.max(np.sum(np.abs(F), axis=0))) * max(durations) > _RADIUS:
        return [np.asarray(exponential(F * t) @ channel) for t in durations]
    results = [channel.copy() for _ in durations]
    term, powers = channel, [1.0] * len(durations)
    for k in range(1, _TERMS):
        term = F @ term / k
        for i, t in enumerate(durations):
            powers[i] *= t
            results[i] = results[i] + powers[i] * term
    return results


def _short(F: Array, channel: Array, h: float) -> Array:
    terms = np.empty((_TERMS, *channel.shape))
    term = channel * np.sqrt(h)
    for k in range(_TERMS):
        terms[k] = term
        term = F @ term * h
    columns = np.tensordot(_WEIGHTS, terms, axes=(0, 0))
    return np.asarray(np.concatenate(list(columns), axis=1))
