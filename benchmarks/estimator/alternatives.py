"""What a user could take in place of a Kalman filter: both need the equation of the one mass that d acts on.

    extended_state_observer     linear, three poles at one bandwidth
    robust_differentiator       Levant's, of second order, solved for d

    s̈ = a(s, ṡ, y, u) + b d,   s the first output, which is measured as y₁

Both return d̂ at the samples as (B,K,1), for one tuning; `best` scans the tuning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.estimator.plants import ARM, CYLINDER, JOINT, MOTOR, Array, Plant
from benchmarks.estimator.records import Record
from benchmarks.estimator.scores import STEADY_FROM


@dataclass(frozen=True)
class Mass:
    """a(s, ṡ, y (B,p), u (B,m)) without d, and b."""

    acceleration: Callable[[Array, Array, Array, Array], Any]
    gain: float


def _masses() -> dict[Plant, Mass]:
    joint, cylinder, motor, arm = (plant.parameters for plant in (JOINT, CYLINDER, MOTOR, ARM))
    return {
        JOINT: Mass(
            lambda s, v, y, u: joint["joint_stiffness"] * (y[:, 1] - s) - joint["motor_damping"] * v + u[:, 0], 1.0
        ),
        CYLINDER: Mass(
            lambda s, v, y, u: (1000.0 * y[:, 1] - cylinder["damping"] * v) / cylinder["mass"], 1.0 / cylinder["mass"]
        ),
        MOTOR: Mass(
            lambda s, v, y, u: (6.0 * motor["flux"] * y[:, 2] - motor["friction"] * v) / motor["inertia"],
            -1.0 / motor["inertia"],
        ),
        ARM: Mass(
            lambda s, v, y, u: (
                (u[:, 1] - arm["elbow_damping"] * v - arm["elbow_friction"] * np.tanh(v / arm["friction_rate"]))
                / arm["elbow_inertia"]
            ),
            arm["forearm"] / arm["elbow_inertia"],
        ),
    }


MASSES = _masses()


def extended_state_observer(record: Record, bandwidth: float) -> Array:
    """Return d̂ (B,K,1) of the observer of z = [s; ṡ; b d], all eigenvalues of (I − K c) Φ at e^{−ωH}."""
    mass, H = MASSES[record.plant], record.H
    Phi = np.array([[1.0, H, 0.5 * H**2], [0.0, 1.0, H], [0.0, 0.0, 1.0]])
    rows = [Phi[0], (Phi @ Phi)[0], (Phi @ Phi @ Phi)[0]]
    # Ackermann's formula.
    shifted = np.linalg.matrix_power(Phi - np.exp(-bandwidth * H) * np.eye(3), 3)
    K = shifted @ np.linalg.solve(np.array(rows), [0.0, 0.0, 1.0])
    pushed = np.array([0.5 * H**2, H, 0.0])
    z = np.zeros((len(record.Y), 3))
    z[:, 0] = record.Y[:, 0, 0]
    found = np.empty((*record.Y.shape[:2], 1))
    for k in range(record.Y.shape[1]):
        y, u = record.Y[:, k], record.U[:, k]
        z = z + K * (y[:, :1] - z[:, :1])
        found[:, k, 0] = z[:, 2] / mass.gain
        z = z @ Phi.T + np.outer(mass.acceleration(z[:, 0], z[:, 1], y, u), pushed)
    return found


def robust_differentiator(record: Record, lipschitz: float) -> Array:
    """Return d̂ (B,K,1) from s̈ of Levant's differentiator, |s⃛| ≤ L; homogeneous discretisation (Livne and Levant, 2014).

    ż₀ = z₁ − 2 L^{1/3} |e|^{2/3} sign e,  ż₁ = z₂ − 2.12 L^{2/3} |e|^{1/3} sign e,  ż₂ = −1.1 L sign e,  e = z₀ − s
    """
    mass, H = MASSES[record.plant], record.H
    z = np.zeros((len(record.Y), 3))
    z[:, 0] = record.Y[:, 0, 0]
    found = np.empty((*record.Y.shape[:2], 1))
    for k in range(record.Y.shape[1]):
        y, u = record.Y[:, k], record.U[:, k]
        found[:, k, 0] = (z[:, 2] - mass.acceleration(y[:, 0], z[:, 1], y, u)) / mass.gain
        error = z[:, 0] - y[:, 0]
        sign, size = np.sign(error), np.abs(error)
        slope0 = z[:, 1] - 2.0 * lipschitz ** (1 / 3) * size ** (2 / 3) * sign
        slope1 = z[:, 2] - 2.12 * lipschitz ** (2 / 3) * size ** (1 / 3) * sign
        slope2 = -1.1 * lipschitz * sign
        z = np.column_stack([z[:, 0] + H * slope0 + 0.5 * H**2 * z[:, 2], z[:, 1] + H * slope1, z[:, 2] + H * slope2])
    return found


def best(record: Record, estimator: Callable[[Record, float], Array], tunings: Array) -> tuple[Array, float]:
    """Return d̂ (B,K,1) of the tuning with the least error on this very record, and that tuning."""
    first = int(STEADY_FROM * len(record.t))
    found: list[tuple[float, Array, float]] = []
    for tuning in tunings.tolist():
        with np.errstate(over="ignore", invalid="ignore"):
            at = estimator(record, tuning)
            error = float(np.mean((at - record.d)[:, first:] ** 2))
        if np.isfinite(error):
            found.append((error, at, tuning))
    _, at, tuning = min(found, key=lambda one: one[0])
    return at, tuning


def bandwidths(record: Record) -> Array:
    """Return bandwidths (rad/s) to scan, up to 4 rad a step."""
    return np.asarray(np.geomspace(4.0, 4.0 / record.H, 16))


def lipschitz_bounds(record: Record) -> Array:
    """Return bounds of |s⃛| to scan: around the rate that d gives to the acceleration."""
    rate = abs(MASSES[record.plant].gain) * record.plant.rate(1)
    return np.asarray(rate * np.geomspace(1e-2, 1e4, 25))
