"""The covariance recursion behind the sampled-data gain, and its limit.

    update    S = C P⁻ Cᵀ + R,   K = P⁻ Cᵀ S⁻¹,   P = (I − K C) P⁻
    predict   P⁻ = Φ P Φᵀ + Q

The recursion is carried out on factors, P = F Fᵀ, by orthogonal triangularisation. Like the Joseph form it keeps P
symmetric and positive, and it keeps twice the digits: between an angle known to 1e-15 and a disturbance of 1e2,
products of covariances would lose the smaller one altogether.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError

# A filter that takes more than 2⁴⁰ steps to forget counts as unstable: after more squarings rounding errors decide on
# which side of the unit circle a pole near it lies.
_MOST_DOUBLINGS = 40
# Each doubling squares what is left to add: after an addition of this relative size the rest is below rounding.
_CONVERGED = 1e-9
# Each pass works in the coordinates that the pass before found. The passes end when one changes them by less than this
# factor.
_MOST_PASSES = 5
_SAME_COORDINATES = 4.0
_TOLERANCE = 1e-6
# Beyond this size the inverse of a factor with rows of length one leaves no digit of a plant; the part of its own
# standard deviation by which each state is then taken to be independent of the others.
_MOST_RESOLVED = 1e12
_LEAST_APART = 1e-8


@dataclass(frozen=True)
class Update:
    """One measurement update: gain K (N,p), factor (N,N) of P after it, factor (p,p) of the innovation's S."""

    K: Array
    factor: Array
    innovation_factor: Array


def update(factor: Array, C: Array, R_factor: Array) -> Update:
    """Update P⁻ = factor factorᵀ (N,N) with a measurement C (p,N) of noise covariance R_factor R_factorᵀ (p,p)."""
    p, N = C.shape
    lower = triangular(np.block([[R_factor, C @ factor], [np.zeros((N, p)), factor]]))
    S_factor = lower[:p, :p]
    K = np.linalg.solve(S_factor.T, lower[p:, :p].T).T
    return Update(K=K, factor=lower[p:, p:], innovation_factor=S_factor)


def predict(factor: Array, Phi: Array, noise_factor: Array) -> Array:
    """Return the factor (N,N) of Φ P Φᵀ + Q, with Q = noise_factor noise_factorᵀ."""
    return triangular(np.hstack([Phi @ factor, noise_factor]))


def stationary(
    Phi: Array,
    C: Array,
    noise_factor: Array,
    R_factor: Array,
    similar_factor: Array | None = None,
    units: Array | None = None,
) -> Array:
    """Return the factor (N,N) of the P⁻ to which the recursion converges.

    The doubling algorithm finds it; as rounding errors matter least where P⁻ is I, it is repeated in such coordinates.
    The first pass works in `units` (N,) of ξ, ones if None. `similar_factor` (N,N), that of a P⁻ for other noise, saves
    it where it is similar enough.
    Raises DesignError where the filter does not forget its errors within 2⁴⁰ steps, or where one more step of the
    recursion, in the states themselves, changes the correction K e by more than 1e-6 of a state's standard deviation.
    """
    change = np.inf
    first = np.eye(len(Phi)) if units is None else np.diag(units)
    starts = [first] if similar_factor is None else [similar_factor, first]
    with np.errstate(all="ignore"):  # what leaves the finite numbers is refused below
        seen = np.asarray(np.linalg.solve(R_factor, C), dtype=float)
        for start in starts:
            try:
                factor = _limit(Phi, seen, noise_factor, start)
                found = update(factor, C, R_factor)
                change = gain_change(found, update(predict(found.factor, Phi, noise_factor), C, R_factor))
            except np.linalg.LinAlgError:
                continue
            if change <= _TOLERANCE:
                return factor
    raise DesignError.report(
        "sampled-data gain",
        expected=f"a stationary covariance, the gain's change per step at most {_TOLERANCE:g} of its size",
        received=f"{change:.1e}",
        likely="a mode that is almost unobservable at this step size, or noise and disturbance of impossible sizes",
    )


def _limit(Phi: Array, C: Array, noise_factor: Array, factor: Array) -> Array:
    """Return the factor (N,N) of the limit of P⁻ for unit measurement noise, in the coordinates that it gives itself.

    The first of them come from `factor` (N,N). Raises LinAlgError where P⁻ has no limit.
    """
    for _ in range(_MOST_PASSES):
        T, resolved = _coordinates(factor)
        z_factor = _doubled(forward(T, Phi @ T), C @ T, forward(T, noise_factor))
        factor = triangular(T @ z_factor)
        sizes = np.abs(np.diag(z_factor))
        same = (sizes < _SAME_COORDINATES) & ((not resolved) | (sizes > 1.0 / _SAME_COORDINATES))
        if np.all(same | ~np.any(z_factor, axis=1)):  # a state that no noise reaches has no size
            break
    return factor


def _doubled(Phi: Array, C: Array, noise_factor: Array) -> Array:
    """Return the factor (N,N) of the limit of P⁻ for unit measurement noise.

    k steps lead from a covariance P to D Dᵀ + E (P⁻¹ + B Bᵀ)⁻¹ Eᵀ. Two such stretches make one of 2k steps; they are
    joined on the factors D and B by orthogonal triangularisation (the structure-preserving doubling algorithm of Chu,
    Fan and Lin, 2005, on square roots). When E has vanished, k steps forget P, and D is the limit. Raises LinAlgError
    where E does not vanish.
    """
    N = len(Phi)
    identity, zero = np.eye(N), np.zeros((N, N))
    E = Phi
    D, B = triangular(np.hstack([noise_factor, zero])), triangular(np.hstack([C.T, zero]))
    for _ in range(_MOST_DOUBLINGS):
        # The first stretch's covariance D Dᵀ is updated with Bᵀ ξ + v, which is what the second stretch measures.
        W = B.T @ D
        both = np.linalg.solve(triangular(np.hstack([identity, W])), np.hstack([B.T @ E, W]))
        seen, correction = both[:, :N], both[:, N:]
        added = E @ np.linalg.solve(triangular(np.hstack([identity, W.T])), D.T).T
        E = E @ (E - D @ (correction.T @ seen))
        D, B = triangular(np.hstack([D, added])), triangular(np.hstack([B, seen.T]))
        if not (np.all(np.isfinite(D)) and np.all(np.isfinite(E))):
            break
        sizes = _row_norms(D)
        forgotten = np.max(np.abs(E * sizes / sizes[:, None])) <= _CONVERGED
        if forgotten and np.max(np.linalg.norm(added, axis=1) / sizes) <= _CONVERGED:
            return D
    raise np.linalg.LinAlgError


def whitening(factor: Array) -> Array:
    """Return T (N,N), lower triangular, of ξ = T z: z has the covariance I, except for states that no noise reaches.

    Where some states nearly determine others, as the temperatures along a rod, rounding errors would be all that is
    left of a plant in such coordinates. There z has a smaller covariance in the directions that are determined.
    """
    return _coordinates(factor)[0]


def _coordinates(factor: Array) -> tuple[Array, bool]:
    """Return T of `whitening`, and whether z has the covariance I in all directions that noise reaches."""
    driven = np.flatnonzero(np.any(factor, axis=1))
    lower = triangular(factor[driven])
    norms = np.linalg.norm(lower, axis=1)
    sizes = np.maximum(np.abs(np.diag(lower)), np.finfo(float).eps * norms)
    np.fill_diagonal(lower, np.copysign(sizes, np.diag(lower)))
    inverse = forward(lower / norms[:, None], np.eye(len(lower)))
    resolved = bool(np.max(np.abs(inverse), initial=0.0) <= _MOST_RESOLVED)
    if not resolved:
        lower = triangular(np.hstack([lower, np.diag(_LEAST_APART * norms)]))
    T = np.eye(len(factor))
    T[np.ix_(driven, driven)] = lower
    return T, resolved


def gain_change(before: Update, after: Update) -> float:
    """Return the largest change of K e, in standard deviations of the state that it corrects."""
    change = (after.K - before.K) @ after.innovation_factor
    return float(np.max(np.linalg.norm(change, axis=1) / _row_norms(after.factor)))


def converged_factor(F: Array, inputs: Array) -> Array:
    """Return the factor (N,N) of X = F X Fᵀ + inputs inputsᵀ, to which x⁺ = F x + inputs v converges.

    It is infinite where x does not forget within 2⁴⁰ steps.
    """
    factor = triangular(np.hstack([inputs, np.zeros_like(F)]))
    with np.errstate(all="ignore"):
        for _ in range(_MOST_DOUBLINGS):
            added = F @ factor
            factor = triangular(np.hstack([factor, added]))
            F = F @ F
            if np.all(np.linalg.norm(added, axis=1) <= _CONVERGED * np.linalg.norm(factor, axis=1)):
                return factor
    return np.full(F.shape, np.inf)


def forward(lower: Array, right: Array) -> Array:
    """Solve lower X = right for a lower triangle (N,N), row by row, so that the scale of the rows does not matter."""
    X = np.array(right)
    for i, row in enumerate(lower):
        X[i] = (X[i] - row[:i] @ X[:i]) / row[i]
    return X


def triangular(rows: Array) -> Array:
    """Return the lower triangle T (m,m) with T Tᵀ = rows rowsᵀ, for rows (m,·) with at least as many columns."""
    m = len(rows)
    reflected = np.asarray(np.linalg.qr(rows.T, mode="raw")[0])
    return np.where(_lower(m), reflected[:, :m], 0.0)


@lru_cache(maxsize=16)
def _lower(m: int) -> NDArray[np.bool_]:
    return np.tri(m, dtype=bool)


def _row_norms(factor: Array) -> Array:
    norms = np.linalg.norm(factor, axis=1)
    return np.asarray(np.where(norms > 0.0, norms, 1.0))
