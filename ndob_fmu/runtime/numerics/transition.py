"""One step of ξ' = F ξ + g w with white noise w: its transition and a factor of the noise's covariance.

    Φ = e^{FH},   N Nᵀ = ∫₀ᴴ e^{Ft} g gᵀ e^{Fᵀt} dt

The noise over a short step is Σ_k F^k g/k! I_k with I_k = ∫₀ᴴ (H − t)^k dw. The covariance of the I_k is
H^{j+k+1}/(j + k + 1), a Hilbert matrix, whose Cholesky factor is known in closed form. So N is computed without a
difference of large numbers, and keeps the digits of its small entries (H^{k+1/2}) as Van Loan's formula does not.
Longer steps are joined from two halves, N = [N_h, Φ_h N_h].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, factorial, log2

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.exponential import exponential
from ndob_fmu.runtime.numerics.kalman import triangular

# With ‖F h‖ ≤ 1/2 the terms left out are below 1e-16 of the first one in Φ, and below 1e-12 in N.
_POWERS = 15
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


# Row k: of F^k g in the columns of N.
SERIES_WEIGHTS = np.ascontiguousarray(_series_weights().T)
_FACTORIALS = np.array([float(factorial(k)) for k in range(_POWERS + 1)])


@dataclass(frozen=True)
class StepParts:
    """Parts of a step, to be made once.

    shares: s of each, 1 for the whole step
    weights (parts,powers + 1): s^k/k!
    """

    shares: tuple[float, ...]
    weights: Array


def parts_of(shares: Sequence[float]) -> StepParts:
    """Return parts of a step by their shares in it."""
    weights = np.array([[share**k for k in range(_POWERS + 1)] for share in shares])
    return StepParts(tuple(shares), np.asarray(weights.reshape(-1, _POWERS + 1) / _FACTORIALS))


_WHOLE = parts_of((1.0,))
NO_PARTS = parts_of(())


@dataclass(frozen=True)
class Transition:
    """A step.

    Phi (N,N): Φ
    noise (N,·): a factor of the noise's covariance
    responses (parts,N,h): e^{F s H} of the held columns, for each part s of the step
    """

    Phi: Array
    noise: Array
    responses: Array


def transition(
    F: Array, channel: Array, H: float, held: Array, parts: StepParts, units: Array | None = None
) -> Transition:
    """Return a step H > 0 s, for F (N,N), the noise's channel g (N,g), and `held` columns (N,h).

    units (N,): powers of two, of ξ, in which ‖F‖ is measured; ones if None

    The number of columns of N depends on ‖F‖ H only by whether that exceeds 1/2.
    """
    if units is not None:
        rows = units[:, None]
        done = transition(F * (units / rows), channel / rows, H, held / rows, parts)
        return Transition(done.Phi * (rows / units), done.noise * rows, done.responses * rows)
    size = float(np.abs(F).sum(axis=0).max()) * H
    doublings = min(max(0, ceil(log2(size / _RADIUS))), _MOST_DOUBLINGS) if size > _RADIUS else 0
    h = H / 2.0**doublings
    powers = _powers(F * h)
    Phi: Array = _sum(powers, _WHOLE.weights)[0]
    noise = _short(powers, channel, h)
    if not doublings:
        return Transition(Phi, noise, _sum(powers, parts.weights) @ held)
    for _ in range(doublings):
        noise = triangular(np.concatenate([noise, Phi @ noise, np.zeros_like(F)], axis=1))
        Phi = Phi @ Phi
    return Transition(Phi, noise, np.array([exponential(F * (share * H)) @ held for share in parts.shares]))


def _powers(X: Array) -> Array:
    """Return X^k (powers + 1,N,N), k = 0, 1, …"""
    N = len(X)
    powers: Array = np.empty((_POWERS + 1, N, N))
    powers[0] = np.eye(N)
    powers[1] = X
    count = 2
    while count <= _POWERS:
        more = min(count - 1, _POWERS + 1 - count)
        powers[count : count + more] = powers[1 : 1 + more] @ powers[count - 1]
        count += more
    return powers


def _sum(powers: Array, weights: Array) -> Array:
    N = powers.shape[1]
    return np.asarray((weights @ powers.reshape(len(powers), -1)).reshape(-1, N, N))


def _short(powers: Array, channel: Array, h: float) -> Array:
    N, count = channel.shape
    terms = powers[:_TERMS] @ (channel * h**0.5)
    columns = (SERIES_WEIGHTS @ terms.reshape(_TERMS, -1)).reshape(_TERMS, N, count)
    return np.asarray(columns.transpose(1, 0, 2).reshape(N, -1))
