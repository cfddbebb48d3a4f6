"""The observer Riccati equation of the paper, eqs. (8) and (24), solved with a checked residual.

    (A + αI) Q + Q (A + αI)ᵀ − Q Cᵀ C Q + π G Gᵀ = 0

At π = 1e16 the entries of Q span a dozen decades and a general solver loses them silently. The large directions of Q
are those of G, then A G, and so on; here the states are first rotated into that order, then scaled by powers of two
(exact in floating point) until Q has a diagonal near one. π is raised to its value by continuation; on the way the
directions within G, within A G and so on are rotated to the principal axes of Q where these differ much in size, as
they do where channels differ in relative degree. The solution is polished by Newton's method until its residual is at
rounding level or it is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError

RESIDUAL_TOLERANCE = 1e-8
_CONTINUATION_FACTOR = 100.0
_SIGN_ITERATIONS = 100
_NEWTON_STEPS = 12
_WELL_CONDITIONED = 10.0


@dataclass(frozen=True)
class RiccatiSolution:
    """A stabilising solution that passed its residual check; one that fails cannot be constructed.

    Q: (n, n) symmetric positive definite
    coordinates: (n, n) T of x = T z, in which Q is balanced: an orthogonal matrix times powers of two
    balanced: (n, n) Q in the states z, of size one. It keeps the small directions, which Q loses to rounding at large π
    residual: Frobenius norm of the equation over that of its largest term, the larger one of states z and states x
    """

    pi: float
    alpha: float
    Q: Array = field(repr=False)
    coordinates: Array = field(repr=False)
    balanced: Array = field(repr=False)
    residual: float

    def __post_init__(self) -> None:
        if not self.residual <= RESIDUAL_TOLERANCE:
            raise DesignError.report(
                f"Riccati equation at pi = {self.pi:g}, alpha = {self.alpha:g}",
                expected=f"a relative residual of at most {RESIDUAL_TOLERANCE:g}",
                received=f"{self.residual:.2e}",
                likely="a mode that is almost unobservable, a zero right of -alpha, or too large a pi",
            )


def solve_riccati(A: Array, C: Array, G: Array, *, pi: float, alpha: float) -> RiccatiSolution:
    """Return the stabilising solution of eq. (8)/(24) for A (n,n), C (p,n), G (n,q), π > 0, α > 0.

    Raises DesignError where the relative residual stays above 1e-8.
    """
    return solve_riccati_over(A, C, G, pis=np.array([pi]), alpha=alpha)[0]


def solve_riccati_over(A: Array, C: Array, G: Array, *, pis: Array, alpha: float) -> list[RiccatiSolution]:
    """Return the solutions for each of the increasing values `pis`, each scaled by the one before it.

    Raises DesignError like `solve_riccati`.
    """
    basis, A_b, G_b, edges = controllability_staircase(A, G)
    C_b = C @ basis
    shifted = A_b + alpha * np.eye(len(A))
    Q_scaled, scale = np.eye(len(A)), np.ones(len(A))
    previous = min(1.0, float(pis[0]))
    solutions = []
    for pi in pis.tolist():
        steps = int(np.ceil(np.log(pi / previous) / np.log(_CONTINUATION_FACTOR)))
        for value in [*np.geomspace(previous, pi, steps + 1)[1:-1], pi]:
            V, scale = _principal_axes(Q_scaled, scale, edges)
            basis, C_b, shifted, G_b = basis @ V, C_b @ V, V.T @ shifted @ V, V.T @ G_b
            Q_scaled, scale = _settle_scale(shifted, C_b, G_b, value, scale)
        previous = pi
        Q = basis @ (scale[:, None] * Q_scaled * scale) @ basis.T
        solutions.append(
            RiccatiSolution(
                pi=pi,
                alpha=alpha,
                Q=Q,
                coordinates=basis * scale,
                balanced=Q_scaled,
                residual=max(
                    _relative_residual(Q_scaled, *_terms(shifted, C_b, G_b, pi, scale)),
                    # Rounding of Q in the states x alone can spoil the gain at extreme π.
                    _relative_size((A + alpha * np.eye(len(A))) @ Q, Q @ C.T @ (C @ Q), pi * G @ G.T),
                ),
            )
        )
    return solutions


def controllability_staircase(A: Array, G: Array) -> tuple[Array, Array, Array, list[int]]:
    """Return an orthogonal basis T (n,n) ordered as G, A G, A² G, …, with Tᵀ A T and Tᵀ G in staircase form.

    The zeros of the staircase are set to exactly zero: their rounding errors, times √π, would swamp the small
    directions of Q. Last come the edges of its blocks, from 0 to n.
    """
    n = len(A)
    T = np.zeros((n, 0))
    edges = [0]
    block = G
    while T.shape[1] < n:
        block = block - T @ (T.T @ block)
        U, sigma, _ = np.linalg.svd(block, full_matrices=False)
        tolerance = n * np.finfo(float).eps * sigma[0] * max(1.0, float(np.linalg.norm(A)))
        rank = int(np.sum(sigma > tolerance))
        if rank == 0:  # uncontrollable rest: any completion of the basis serves
            T = np.linalg.qr(np.hstack([T, np.eye(n)]))[0]
            break
        T = np.linalg.qr(np.hstack([T, U[:, :rank]]))[0]
        edges.append(T.shape[1])
        block = A @ T[:, edges[-2] : edges[-1]]
    A_t, G_t = T.T @ A @ T, T.T @ G
    G_t[edges[1] if len(edges) > 1 else 0 :] = 0.0
    for k in range(2, len(edges)):
        A_t[edges[k] :, edges[k - 2] : edges[k - 1]] = 0.0
    return T, A_t, G_t, edges if edges[-1] == n else [*edges, n]


def lyapunov(A: Array, Q: Array) -> Array:
    """Return X with A X + X Aᵀ + Q = 0 for a Hurwitz A, by the matrix sign iteration (needs no Schur form)."""
    A_k, X = A, Q
    for _ in range(_SIGN_ITERATIONS):
        inverse = np.linalg.inv(A_k)
        c = float(np.sqrt(np.linalg.norm(inverse) / np.linalg.norm(A_k)))
        X = 0.5 * (c * X + inverse @ X @ inverse.T / c)
        A_next = 0.5 * (c * A_k + inverse / c)
        change = np.linalg.norm(A_next - A_k)
        A_k = A_next
        if change <= 1e-14 * np.linalg.norm(A_k):
            break
    return np.asarray(0.25 * (X + X.T))


def _terms(shifted: Array, C: Array, G: Array, pi: float, scale: Array) -> tuple[Array, Array, Array]:
    """Return A + αI, CᵀC and πGGᵀ in the states z of x = scale * z."""
    C_s = C * scale
    G_s = np.sqrt(pi) * G / scale[:, None]
    return shifted * scale / scale[:, None], C_s.T @ C_s, G_s @ G_s.T


def _settle_scale(shifted: Array, C: Array, G: Array, pi: float, scale: Array) -> tuple[Array, Array]:
    """Return the solution in scaled states and a scale that its own diagonal confirms."""
    for _ in range(6):
        Q = _solve_scaled(*_terms(shifted, C, G, pi, scale))
        diagonal = np.diag(Q)
        if not np.all(diagonal > 0):
            break
        correction = np.exp2(np.round(0.5 * np.log2(diagonal)))
        if np.all(correction == 1.0):
            break
        scale = scale * correction
    return Q, scale


def _principal_axes(Q_scaled: Array, scale: Array, edges: list[int]) -> tuple[Array, Array]:
    """Return an orthogonal V (n,n) and the scale (n,) along its axes.

    V makes a diagonal block of Q diagonal where the scale alone leaves it ill-conditioned; elsewhere it is I.
    """
    V, scale = np.eye(len(scale)), scale.copy()
    for start, stop in pairwise(edges):
        block = slice(start, stop)
        own = Q_scaled[block, block]
        if np.all(np.isfinite(own)) and np.all(np.diag(own) > 0) and np.linalg.cond(own) > _WELL_CONDITIONED:
            sizes, V[block, block] = np.linalg.eigh(scale[block, None] * own * scale[block])
            smallest = np.finfo(float).eps * sizes[-1]
            scale[block] = np.exp2(np.round(0.5 * np.log2(np.maximum(sizes, smallest))))
    return V, scale


def _solve_scaled(A: Array, S: Array, V: Array) -> Array:
    """Solve A Q + Q Aᵀ − Q S Q + V = 0 by the sign of its Hamiltonian, then Newton; NaN where no solution is found."""
    try:
        Q = _solve_by_sign(A, S, V)
        best, best_residual = Q, _relative_residual(Q, A, S, V)
        for _ in range(_NEWTON_STEPS):
            closed = A - Q @ S
            Q = Q + lyapunov(closed, A @ Q + Q @ A.T - Q @ S @ Q + V)
            residual = _relative_residual(Q, A, S, V)
            if not residual < 0.5 * best_residual:
                break
            best, best_residual = Q, residual
    except np.linalg.LinAlgError:
        return np.full_like(A, np.nan)
    if np.any(np.linalg.eigvals(A - best @ S).real >= 0):
        return np.full_like(A, np.nan)
    return best


def _solve_by_sign(A: Array, S: Array, V: Array) -> Array:
    n = len(A)
    Z = np.block([[A.T, -S], [-V, -A]])
    for _ in range(_SIGN_ITERATIONS):
        inverse = np.linalg.inv(Z)
        c = float(np.sqrt(np.linalg.norm(inverse) / np.linalg.norm(Z)))
        Z_next = 0.5 * (c * Z + inverse / c)
        change = np.linalg.norm(Z_next - Z)
        Z = Z_next
        if change <= 1e-13 * np.linalg.norm(Z):
            break
    # (sign(H) + I) annihilates the stable subspace, spanned by [I; Q].
    left = np.vstack([Z[:n, n:], Z[n:, n:] + np.eye(n)])
    right = -np.vstack([Z[:n, :n] + np.eye(n), Z[n:, :n]])
    Q = np.linalg.lstsq(left, right, rcond=None)[0]
    return np.asarray(0.5 * (Q + Q.T))


def _relative_residual(Q: Array, A: Array, S: Array, V: Array) -> float:
    return _relative_size(A @ Q, Q @ S @ Q, V)


def _relative_size(AQ: Array, QSQ: Array, V: Array) -> float:
    largest = max(np.linalg.norm(AQ), np.linalg.norm(QSQ), np.linalg.norm(V))
    return float(np.linalg.norm(AQ + AQ.T - QSQ + V) / largest)
