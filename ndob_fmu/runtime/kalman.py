"""The covariance recursion behind the sampled-data gain, and where it comes to rest.

    update    S = C P⁻ Cᵀ + R,   K = P⁻ Cᵀ S⁻¹,   P = (I − K C) P⁻
    predict   P⁻ = Φ P Φᵀ + Q

The recursion is carried out on square roots, P = F Fᵀ, by orthogonal triangularisation. It serves what the Joseph form
is for, a symmetric and positive P, and keeps twice the digits: between an angle known to 1e-15 and a disturbance of
1e2, products of covariances would lose the smaller one altogether.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.errors import DesignError
from ndob_fmu.runtime.riccati import Array

_TRIAL_STEPS = 12
_MOST_DOUBLINGS = 60
_MOST_POLISHING = 200
_MOST_SCALINGS = 5
_TOLERANCE = 1e-9


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

    A few steps of the recursion give the states' magnitudes; in states scaled by them the doubling algorithm squares
    its way to the limit, and steps of the recursion itself take off its rounding errors. Raises DesignError where two
    successive steps still differ by more than 1e-9 in the gain, relative to its scaled size.
    """
    # A mode that no sample sees grows beyond all numbers; the change of the gain then shows it.
    with np.errstate(over="ignore", invalid="ignore"):
        return _stationary(Phi, C, noise_factor, R_factor)


def _stationary(Phi: Array, C: Array, noise_factor: Array, R_factor: Array) -> Array:
    N = len(Phi)
    factor = predict(np.zeros((N, N)), Phi, noise_factor)
    for _ in range(_TRIAL_STEPS + N):
        factor = predict(update(factor, C, R_factor).factor, Phi, noise_factor)
    scale = _row_norms(factor)
    for _ in range(_MOST_SCALINGS):
        over_noise = np.asarray(np.linalg.solve(R_factor, C * scale))
        P = _doubled(Phi * scale / scale[:, None], over_noise, noise_factor / scale[:, None])
        if P is None:
            break
        values, vectors = np.linalg.eigh(P)
        factor = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        correction = np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))
        if np.max(np.abs(np.log(correction))) < 1.0:
            break
        scale = scale * correction
    step = update(factor, C, R_factor)
    for _ in range(_MOST_POLISHING):
        factor = predict(step.factor, Phi, noise_factor)
        after = update(factor, C, R_factor)
        change = gain_change(step, after)
        step = after
        if change <= _TOLERANCE:
            _require_stable(Phi @ (np.eye(N) - step.K @ C))
            return factor
    raise DesignError.report(
        "sampled-data gain",
        expected=f"a stationary covariance, the gain's change per step at most {_TOLERANCE:g} of its size",
        received=f"{change:.1e}",
        likely="a mode that is almost unobservable at this step size, or noise and disturbance of impossible sizes",
    )


def _require_stable(error_dynamics: Array) -> None:
    radius = float(np.max(np.abs(np.linalg.eigvals(error_dynamics))))
    if radius >= 1.0:
        raise DesignError.report(
            "sampled-data gain",
            expected="a stationary covariance with all poles of the error inside the unit circle",
            received=f"one of magnitude {radius:.6g}",
            likely="a mode that no output sees",
        )


def gain_change(before: Update, after: Update) -> float:
    """Return the largest change of a gain, in standard deviations of the state per standard deviation of the sample."""
    outputs = np.linalg.norm(after.innovation_factor, axis=1)
    return float(np.max(np.abs(after.K - before.K) * outputs / _row_norms(after.factor)[:, None]))


def covariance_of(F: Array, inputs: Array) -> Array:
    """Return X = F X Fᵀ + inputs inputsᵀ for a stable F (N,N): the stationary covariance of x⁺ = F x + inputs v."""
    X = inputs @ inputs.T
    for _ in range(_MOST_DOUBLINGS):
        added = F @ X @ F.T
        X = X + added
        F = F @ F
        if np.max(np.abs(added)) <= 1e-16 * np.max(np.abs(X)):
            break
    return np.asarray(X)


def _doubled(Phi: Array, C: Array, noise_factor: Array) -> Array | None:
    """Return the limit of P⁻ for unit measurement noise by the structure-preserving doubling algorithm, or None."""
    A, G, H = Phi.T, C.T @ C, noise_factor @ noise_factor.T
    identity = np.eye(len(A))
    try:
        for _ in range(_MOST_DOUBLINGS):
            W = np.linalg.solve(identity + G @ H, np.hstack([A, G]))
            W_A, W_G = W[:, : len(A)], W[:, len(A) :]
            added = A.T @ H @ W_A
            A, G, H = A @ W_A, G + A @ W_G @ A.T, H + 0.5 * (added + added.T)
            if not np.all(np.isfinite(H)):
                return None
            if np.linalg.norm(added) <= 1e-15 * np.linalg.norm(H):
                return np.asarray(H)
    except np.linalg.LinAlgError:
        return None
    return None


def _row_norms(factor: Array) -> Array:
    norms = np.linalg.norm(factor, axis=1)
    return np.asarray(np.where(norms > 0.0, norms, 1.0))


def _triangular(rows: Array) -> Array:
    """Return the lower triangle T (m,m) with T Tᵀ = rows rowsᵀ."""
    return np.asarray(np.asarray(np.linalg.qr(rows.T, mode="r")).T)
