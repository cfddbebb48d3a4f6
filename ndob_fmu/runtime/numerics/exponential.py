"""Exact integration of a linear system over a step: the matrix exponential and the φ-functions behind it.

    φ₀(X) = e^X,   φ_{k+1}(X) = (φ_k(X) − I/k!) X⁻¹        (entire functions: X may be singular)

With them, x' = A x + N₀ + N₁ t + N₂ t²/2 has x(h) = e^{Ah} x₀ + h φ₁ N₀ + h² φ₂ N₁ + h³ φ₃ N₂ at X = A h.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.runtime.arrays import Array

# Padé [7/7] of the exponential, and the 1-norm up to which it is exact to rounding (Higham, 2005).
_PADE = (17297280.0, 8648640.0, 1995840.0, 277200.0, 25200.0, 1512.0, 56.0, 1.0)
_PADE_RADIUS = 0.95


def exponential(X: Array, units: Array | None = None) -> Array:
    """Return e^X for X (n,n) by scaling and squaring; its norm counts in `units` (n,) of its rows and columns."""
    if units is not None:
        return np.asarray(exponential(X * units / units[:, None]) * units[:, None] / units)
    squarings = max(0, int(np.ceil(np.log2(max(float(np.linalg.norm(X, 1)) / _PADE_RADIUS, 1e-300)))))
    X = X / 2.0**squarings
    X2 = X @ X
    X4 = X2 @ X2
    X6 = X4 @ X2
    identity = np.eye(len(X))
    b = _PADE
    odd = X @ (b[7] * X6 + b[5] * X4 + b[3] * X2 + b[1] * identity)
    even = b[6] * X6 + b[4] * X4 + b[2] * X2 + b[0] * identity
    result: Array = np.asarray(np.linalg.solve(even - odd, even + odd))
    for _ in range(squarings):
        result = result @ result
    return result


@dataclass(frozen=True)
class ExponentialStep:
    """The coefficients of one step h of the exponential Runge–Kutta method of order 4 (Cox and Matthews, 2002).

    For x' = A x + N(t, x). It is exact where N is a quadratic polynomial in t, and stable however stiff A is.
    """

    half: Array = field(repr=False)
    full: Array = field(repr=False)
    half_weight: Array = field(repr=False)
    start_weight: Array = field(repr=False)
    middle_weight: Array = field(repr=False)
    end_weight: Array = field(repr=False)

    def advance(self, x: Array, N: Callable[[Array, int], Array]) -> Array:
        """Return x (n,) a step later; N(x, i) is N at the start (i = 0), the middle (1) or the end (2) of the step."""
        N_start = N(x, 0)
        first = self.half @ x + self.half_weight @ N_start
        N_first = N(first, 1)
        second = self.half @ x + self.half_weight @ N_first
        N_second = N(second, 1)
        third = self.half @ first + self.half_weight @ (2.0 * N_second - N_start)
        return np.asarray(
            self.full @ x
            + self.start_weight @ N_start
            + self.middle_weight @ (N_first + N_second)
            + self.end_weight @ N(third, 2)
        )


def exponential_step(A: Array, h: float, coordinates: Array) -> ExponentialStep:
    """Prepare a step h of x' = A x + N; A (n,n) is balanced in the coordinates z of x = T z, T (n,n)."""
    n = len(A)
    T_inv = np.linalg.inv(coordinates)
    X = T_inv @ A @ coordinates * h

    def phi(X: Array, orders: int) -> list[Array]:
        # e^{[X I 0 …; 0 0 I …; …; 0 0 0 …]} has φ₀(X), φ₁(X), … in its first row of blocks.
        M = np.eye(orders * n, k=n)
        M[:n, :n] = X
        E = exponential(M)[:n]
        return [np.asarray(coordinates @ E[:, k * n : (k + 1) * n] @ T_inv) for k in range(orders)]

    half_0, half_1 = phi(0.5 * X, 2)
    full_0, phi_1, phi_2, phi_3 = phi(X, 4)
    return ExponentialStep(
        half=half_0,
        full=full_0,
        half_weight=0.5 * h * half_1,
        start_weight=h * (phi_1 - 3.0 * phi_2 + 4.0 * phi_3),
        middle_weight=h * (2.0 * phi_2 - 4.0 * phi_3),
        end_weight=h * (4.0 * phi_3 - phi_2),
    )
