"""The constant matrices of a plant: all that the gains are designed from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True)
class LinearPart:
    """The constant matrices of ẋ = A x + B u + G_f f(x, u) + G_d d, y = C x.

    That is eq. (20), and eq. (1) where G_f = G_d.

    A (n,n), B (n,m), C (p,n), G_f (n,q1), G_d (n,q2): the matrices
    matched: whether f and d enter through the same channel
    """

    A: Array
    B: Array
    C: Array
    G_f: Array
    G_d: Array
    matched: bool

    @cached_property
    def G(self) -> Array:
        """The unknown-input channel (n,q): G_d where f is matched, else [G_f G_d]."""
        return self.G_d if self.matched else np.hstack([self.G_f, self.G_d])

    def f_rate(self, lipschitz: float) -> float:
        """Return a bound of the rate (1/s) at which G_f f moves the state, ‖G_f‖ γ."""
        return float(np.linalg.norm(self.G_f, 2)) * lipschitz if self.G_f.size else 0.0

    @cached_property
    def G_inverse(self) -> Array:
        """The left inverse of G, (q,n)."""
        return np.asarray(np.linalg.pinv(self.G))

    @cached_property
    def selector(self) -> Array:
        """(q2, q) matrix that picks d out of the estimated unknown inputs, [0 I] of eq. (23)."""
        q, q_d = self.G.shape[1], self.G_d.shape[1]
        return np.eye(q)[q - q_d :]
