"""The functions φ_k of exponential integrators, of matrices of any norm.

    φ₀(Z) = e^Z,   φ_k(Z) = Σ_j Z^j / (j + k)!,   φ_k(Z) = Z φ_{k+1}(Z) + I/k!
    2^k φ_k(2Z) = φ₀(Z) φ_k(Z) + Σ_{1≤j≤k} φ_j(Z) / (k − j)!

The series is summed at Z/2^s and doubled s times. For an eigenvalue λ < 0 the doubling adds positive numbers only, so
that the result is as exact for a stiff Z as for any other (Skaflestad and Wright, 2009).
"""

from __future__ import annotations

from math import factorial, frexp

import numpy as np

from ndob_fmu.runtime.arrays import Array

HIGHEST = 4  # φ₀ … φ₄ are computed
# φ₄ by its series up to Z¹⁵, exact to rounding for a norm below 1, in blocks of four powers.
_SERIES = np.array([[1.0 / factorial(HIGHEST + 4 * i + j) for j in range(4)] for i in range(4)])
_SUM = np.array(
    [[1.0 / factorial(k - j) if 1 <= j <= k else 0.0 for j in range(HIGHEST + 1)] for k in range(HIGHEST + 1)]
)
_SCALE = 0.5 ** np.arange(HIGHEST + 1)[:, None, None]


def phi_functions(Z: Array) -> tuple[Array, Array]:
    """Return φ₁(Z/2), (n,n), and φ₀ … φ₄ of Z, (5,n,n), for Z (n,n)."""
    n = len(Z)
    squared = Z @ Z
    fourth = squared @ squared
    # Roots of norms of powers depend less on the units of the states than the norm of Z (Al-Mohy and Higham, 2009).
    size = max(_norm(fourth) ** (1 / 4), _norm(fourth @ Z) ** (1 / 5))
    doublings = max(frexp(size)[1], 1)
    scale = 0.5**doublings
    Z, squared, fourth = Z * scale, squared * scale**2, fourth * scale**4
    powers = np.stack([np.eye(n), Z, squared, squared @ Z])
    blocks = np.tensordot(_SERIES, powers, axes=1)
    phi = np.empty((HIGHEST + 1, n, n))
    phi[HIGHEST] = ((blocks[3] @ fourth + blocks[2]) @ fourth + blocks[1]) @ fourth + blocks[0]
    for k in reversed(range(HIGHEST)):
        phi[k] = Z @ phi[k + 1] + np.eye(n) / factorial(k)
    half = phi[1]
    for _ in range(doublings):
        half = phi[1]
        phi = _SCALE * (phi[0] @ phi + np.tensordot(_SUM, phi, axes=1))
    return half, phi


def _norm(Z: Array) -> float:
    return float(np.max(np.sum(np.abs(Z), axis=0), initial=0.0))
