"""The covariance recursion behind the sampled-data gain, and where it comes to rest.

    update    S = C P⁻ Cᵀ + R,   K = P⁻ Cᵀ S⁻¹,   P = (I − K C) P⁻
    predict   P⁻ = Φ P Φᵀ + Q

The recursion is carried out on square roots, P = F Fᵀ, by orthogonal triangularisation. It serves what the Joseph form
is for, a symmetric and positive P, and keeps twice the digits: between an angle known to 1e-15 and a disturbance of
1e2, products of covariances would lose the smaller one altogether.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.errors import DesignError
from ndob_fmu.runtime.riccati import Array

Coordinates = Callable[[Array], tuple[Array, Array]]

_TRIAL_STEPS = 12
_MOST_DOUBLINGS = 60
_MOST_POLISHING = 200
_MOST_SCALINGS = 5
_TOLERANCE = 1e-8


@dataclass(frozen=True)
class Update:
    """One measurement update: gain K (N,p), factor (N,N) of P after it, factor (p,p) of the innovation's S."""

    K: Array
    factor: Array
    innovation_factor: Array


def update(factor: Array, C: Array, R_factor: Array) -> Update:
    """Update P⁻ = factor factorᵀ (N,N) with a measurement C (p,N) of noise covariance R_factor R_factorᵀ (p,p)."""
    p, N = C.shape
    lower = _triangular(np.block([[R_factor, C @ factor], [np.zeros((N, p)), factor]]))
    S_factor = lower[:p, :p]
    K = np.linalg.solve(S_factor.T, lower[p:, :p].T).T
    return Update(K=K, factor=lower[p:, p:], innovation_factor=S_factor)


def predict(factor: Array, Phi: Array, noise_factor: Array) -> Array:
    """Return the factor (N,N) of Φ P Φᵀ + Q, with Q = noise_factor noise_factorᵀ."""
    return _triangular(np.hstack([Phi @ factor, noise_factor]))


def stationary(Phi: Array, C: Array, noise_factor: Array, R_factor: Array) -> Array:
    """Return the factor (N,N) of the P⁻ at which the recursion rests.

    A few steps of the recursion give the states' magnitudes; in coordinates scaled by them the doubling algorithm
    squares its way to the limit, and steps of the recursion itself take off its rounding errors. Where a direction
    across the states is known so much better than each of them that it is lost between them, the coordinates are turned
    to the covariance's own axes. Raises DesignError where two successive steps still differ by more than 1e-8 in what
    the gain makes of a sample, relative to the state's standard deviation, or where the
    filter does not forget its errors.
    """
    change = np.inf
    with np.errstate(all="ignore"):  # what leaves the finite numbers is refused below
        trial = _few_steps(Phi, C, noise_factor, R_factor)
        for coordinates in (_scaled, own_coordinates):
            try:
                factor, received = _rest_in(coordinates, trial, Phi, C, noise_factor, R_factor)
            except np.linalg.LinAlgError:
                continue
            if received <= _TOLERANCE:
                return factor
            change = min(change, received)
    raise DesignError.report(
        "sampled-data gain",
        expected=f"a stationary covariance, the gain's change per step at most {_TOLERANCE:g} of its size",
        received=f"{change:.1e}",
        likely="a mode that is almost unobservable at this step size, or noise and disturbance of impossible sizes",
    )


def _few_steps(Phi: Array, C: Array, noise_factor: Array, R_factor: Array) -> Array:
    N = len(Phi)
    factor = predict(np.zeros((N, N)), Phi, noise_factor)
    for _ in range(_TRIAL_STEPS + N):
        factor = predict(update(factor, C, R_factor).factor, Phi, noise_factor)
    return factor


def _rest_in(
    coordinates: Coordinates, factor: Array, Phi: Array, C: Array, noise_factor: Array, R_factor: Array
) -> tuple[Array, float]:
    """Return the factor (N,N) of P⁻ found in coordinates made for `factor`, and the last step's change of the gain.

    Raises LinAlgError where the numbers get out of hand.
    """
    for _ in range(_MOST_SCALINGS):
        T, T_inverse = coordinates(factor)
        moved, driven = T_inverse @ Phi @ T, T_inverse @ noise_factor
        seen: Array = np.asarray(np.linalg.solve(R_factor, C @ T))
        P = _doubled(moved, seen, driven)
        values, vectors = np.linalg.eigh(P)
        z_factor = vectors * np.sqrt(np.maximum(values, 0.0))
        factor = T @ z_factor
        if np.max(np.abs(np.log(np.maximum(np.diag(P), np.finfo(float).tiny)))) < 2.0:
            break
    identity = np.eye(len(C))
    step, change = update(z_factor, seen, identity), np.inf
    for _ in range(_MOST_POLISHING):
        z_factor = predict(step.factor, moved, driven)
        after = update(z_factor, seen, identity)
        change = gain_change(step, after)
        step = after
        if change <= _TOLERANCE:
            break
    # A slow filter changes by little in a step wherever it stands: only at rest does it also forget its errors.
    forgets = np.max(np.abs(np.linalg.eigvals(moved - step.K @ (seen @ moved)))) < 1.0
    return np.asarray(T @ z_factor), change if forgets else np.inf


def _scaled(factor: Array) -> tuple[Array, Array]:
    """Return T and T⁻¹ (N,N) of ξ = T z in which the states have the standard deviation one."""
    scale = _row_norms(factor)
    return np.diag(scale), np.diag(1.0 / scale)


def own_coordinates(factor: Array) -> tuple[Array, Array]:
    """Return T and T⁻¹ (N,N) of ξ = T z in which the covariance is I, but for what no noise reaches."""
    scale = _row_norms(factor)
    axes, sizes, _ = np.linalg.svd(factor / scale[:, None])
    sizes = np.maximum(sizes, np.finfo(float).eps * sizes[0])
    return scale[:, None] * axes * sizes, axes.T / sizes[:, None] / scale


def gain_change(before: Update, after: Update) -> float:
    """Return the largest change of K e, in standard deviations of the state that it corrects."""
    change = (after.K - before.K) @ after.innovation_factor
    return float(np.max(np.linalg.norm(change, axis=1) / _row_norms(after.factor)))


def covariance_of(F: Array, inputs: Array) -> Array:
    """Return X = F X Fᵀ + inputs inputsᵀ, the covariance at rest of x⁺ = F x + inputs v; infinite if there is none."""
    X = inputs @ inputs.T
    with np.errstate(all="ignore"):
        for _ in range(_MOST_DOUBLINGS):
            added = F @ X @ F.T
            X = X + added
            F = F @ F
            if np.max(np.abs(added)) <= 1e-16 * np.max(np.abs(X)):
                return np.asarray(X)
    return np.full(X.shape, np.inf)


def _doubled(Phi: Array, C: Array, noise_factor: Array) -> Array:
    """Return the limit of P⁻ for unit measurement noise by the structure-preserving doubling algorithm.

    Raises LinAlgError where there is none.
    """
    A, G, H = Phi.T, C.T @ C, noise_factor @ noise_factor.T
    identity = np.eye(len(A))
    for _ in range(_MOST_DOUBLINGS):
        W = np.linalg.solve(identity + G @ H, np.hstack([A, G]))
        W_A, W_G = W[:, : len(A)], W[:, len(A) :]
        added = A.T @ H @ W_A
        A, G, H = A @ W_A, G + A @ W_G @ A.T, H + 0.5 * (added + added.T)
        if not np.all(np.isfinite(H)):
            break
        if np.linalg.norm(added) <= 1e-15 * np.linalg.norm(H):
            return np.asarray(H)
    raise np.linalg.LinAlgError


def _row_norms(factor: Array) -> Array:
    norms = np.linalg.norm(factor, axis=1)
    return np.asarray(np.where(norms > 0.0, norms, 1.0))


def _triangular(rows: Array) -> Array:
    """Return the lower triangle T (m,m) with T Tᵀ = rows rowsᵀ."""
    return np.asarray(np.asarray(np.linalg.qr(rows.T, mode="r")).T)
