"""The paper's observer gain: L and W of eqs. (7)–(9), (24), and the DC-exact M that may stand in for √π W."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.riccati import RiccatiSolution, solve_riccati


@dataclass(frozen=True)
class LinearPart:
    """The constant matrices of ẋ = A x + B u + G_f f(x, u) + G_d d, y = C x (eq. 20; eq. 1 where G_f is G_d).

    A (n,n), B (n,m), C (p,n), G_f (n,q1), G_d (n,q2); `matched` says that f and d enter through the same channel.
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


@dataclass(frozen=True)
class Gains:
    """The gain at one π. L (n,p) of eq. (7); W (q,p), W Wᵀ = I, of eq. (9); M (q,p), exact at DC."""

    riccati: RiccatiSolution = field(repr=False)
    L: Array
    W: Array
    M: Array


def paper_gains(linear: LinearPart, *, pi: float, alpha: float) -> Gains:
    """Design the paper's observer at one π > 0, α > 0. Raises DesignError where the Riccati residual is too large."""
    riccati = solve_riccati(linear.A, linear.C, linear.G, pi=pi, alpha=alpha)
    L = riccati.Q @ linear.C.T
    return Gains(riccati=riccati, L=L, W=orthogonal_factor(linear, L), M=dc_inverse(linear, L))


def orthogonal_factor(linear: LinearPart, L: Array) -> Array:
    """Return W (q,p), the orthogonal polar factor of G⁺ L (Remark 2): the nearest matrix with W Wᵀ = I."""
    U, _, Vt = np.linalg.svd(linear.G_inverse @ L, full_matrices=False)
    return np.asarray(U @ Vt)


def dc_inverse(linear: LinearPart, L: Array) -> Array:
    """Return M (q,p) = [C (L C − A)⁻¹ G]⁻¹, the left inverse where p > q: M (y − C x̂) is exact for constant inputs."""
    return np.asarray(np.linalg.pinv(linear.C @ np.linalg.solve(L @ linear.C - linear.A, linear.G)))
