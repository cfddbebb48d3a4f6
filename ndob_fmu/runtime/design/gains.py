"""The paper's observer gain: L and W of eqs. (7)–(9), (24), and M, used instead of √π W, exact at DC."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.riccati import RiccatiSolution, solve_riccati


@dataclass(frozen=True)
class Gains:
    """The gain at one π.

    riccati: the solution of eq. (8)/(24).
    L (n,p): of eq. (7).
    W (q,p): of eq. (9), W Wᵀ = I.
    M (q,p): used instead of √π W; exact for a constant d.
    """

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
