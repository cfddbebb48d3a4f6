"""Other estimators that a user could choose instead of this package's observer; they share no code with it.

    extended_kalman_filter      r integrated disturbances, linearised again at every step
    extended_state_observer     linear, all poles at one bandwidth
    second_difference           the equation of motion solved for d with differences of the samples

All work on a batch of B records at once, so that a scan over tuning costs little more than one run. A record of K
samples, y_k at t_k = k H with k = 0 … K − 1, gives for each the estimate there, d̂(t_k | y_k), and the prediction a step
ahead, d̂(t_k + H | y_k).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, factorial

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LONGEST_SUBSTEP = 1e-3
_TAYLOR_TERMS = 16


@dataclass(frozen=True)
class System:
    """ẋ = A x + G_f f(x) + G_d d, y = C x, with A (n,n), C (p,n), G_f (n,q1), G_d (n,q).

    f takes x (B,n) and returns (B,q1); jacobian returns ∂f/∂x (B,q1,n).
    """

    A: Array
    C: Array
    G_f: Array
    G_d: Array
    f: Callable[[Array], Array]
    jacobian: Callable[[Array], Array]


@dataclass(frozen=True)
class Estimates:
    """at_sample and ahead (B,K,rows): what was read of the estimate at t_k and for t_k + H; K (B,N,p): last gain."""

    at_sample: Array
    ahead: Array
    K: Array


def linear_system(A: Array, C: Array, G_d: Array) -> System:
    """Return a system without f."""
    n = len(A)
    return System(A, C, np.zeros((n, 0)), G_d, lambda x: np.zeros((len(x), 0)), lambda x: np.zeros((len(x), 0, n)))


def extended_kalman_filter(
    system: System,
    order: int,
    H: float,
    samples: Array,
    *,
    noise_std: Array,
    intensity: Array,
    x_hat: Array,
    prior_std: Array,
    read: Array | None = None,
) -> Estimates:
    """Run the extended Kalman filter of ξ = [x; d; ḋ; …], N = n + r q, with white noise behind d^{(r)}.

    samples (B,K,p); noise_std (B,p) of a sample; intensity (B,q) of the noise behind d^{(r)}, of that on G_d for r = 0;
    x_hat (n,) and prior_std (N,) the start; read (rows,N) what to record of ξ̂, by default d̂.

        update    K = P⁻ Cᵀ (C P⁻ Cᵀ + R)⁻¹,  ξ̂ = ξ̂⁻ + K (y − C x̂⁻),  P = (I − K C) P⁻
        predict   ξ̂' = F(ξ̂) by Runge–Kutta of order 4;  P⁻ = Φ P Φᵀ + Q,  Φ and Q by Van Loan from ∂F/∂ξ at ξ̂

    Covariances are carried as square roots, so that no comparison is lost to rounding.
    """
    n, q = system.G_d.shape
    batch, count, p = samples.shape
    N = n + order * q
    A, noise = _with_disturbances(system, order)
    C = np.hstack([system.C, np.zeros((p, N - n))])
    if read is None:
        read = np.eye(N)[n : n + q]
    scale = H ** _integrations(A + _jacobian_pattern(system, N), noise)
    half_noise = noise / scale[:, None] * np.sqrt(H)
    substeps = ceil(H / _LONGEST_SUBSTEP - 1e-9)

    def slope(xi: Array) -> Array:
        value: Array = xi @ A.T
        value[:, :n] += system.f(xi[:, :n]) @ system.G_f.T
        return value

    def linearised(xi: Array) -> Array:
        value: Array = np.broadcast_to(A, (batch, N, N)).copy()
        value[:, :n, :n] += system.G_f @ system.jacobian(xi[:, :n])
        return value

    xi = np.tile(np.concatenate([x_hat, np.zeros(N - n)]), (batch, 1))
    factor = np.broadcast_to(np.diag(prior_std), (batch, N, N))
    R_factor = noise_std[:, :, None] * np.eye(p)
    at_sample, ahead = np.empty((2, batch, count, len(read)))
    K = np.zeros((batch, N, p))
    for k in range(count):
        S_factor, gain_factor, factor = _updated(factor, C, R_factor)
        K = np.swapaxes(np.linalg.solve(np.swapaxes(S_factor, 1, 2), np.swapaxes(gain_factor, 1, 2)), 1, 2)
        xi = xi + (K @ (samples[:, k] - xi @ C.T)[:, :, None])[:, :, 0]
        at_sample[:, k] = xi @ read.T
        Phi, noise_factor = _van_loan(
            linearised(xi) * H * scale / scale[:, None], half_noise * np.sqrt(intensity)[:, None, :]
        )
        Phi = Phi * scale[:, None] / scale
        factor = _triangular(np.concatenate([Phi @ factor, scale[:, None] * noise_factor], axis=2))
        xi = _runge_kutta(slope, xi, H / substeps, substeps)
        ahead[:, k] = xi @ read.T
    return Estimates(at_sample, ahead, K)


def _with_disturbances(system: System, order: int) -> tuple[Array, Array]:
    """Return A (N,N) of ξ without f, and the channel (N,q) of the white noise."""
    n, q = system.G_d.shape
    N = n + order * q
    A = np.zeros((N, N))
    A[:n, :n] = system.A
    if order == 0:
        return A, system.G_d
    A[:n, n : n + q] = system.G_d
    A[n : N - q, n + q :] = np.eye(N - n - q)
    return A, np.eye(N)[:, N - q :]


def _jacobian_pattern(system: System, N: int) -> Array:
    n = len(system.A)
    pattern = np.zeros((N, N))
    pattern[:n, :n] = system.G_f @ system.jacobian(np.full((1, n), 0.5))[0]
    return pattern


def _integrations(A: Array, noise: Array) -> Array:
    """Return for every state (N,) how many integrations lie between it and the nearest noise, at least one.

    In states scaled by H to that power all of Q's entries are of one size and Van Loan's formula loses none of them.
    """
    links = (A != 0.0).astype(float)
    reached = np.any(noise != 0.0, axis=1)
    depth = np.where(reached, 1.0, 0.0)
    for distance in range(2, len(A) + 1):
        new = (links @ reached > 0.0) & ~reached
        depth[new] = distance
        reached = reached | new
    return np.where(depth > 0.0, depth, float(len(A)))


def _van_loan(A: Array, noise: Array) -> tuple[Array, Array]:
    """Return e^A (B,N,N) and the factor (B,N,N) of ∫₀¹ e^{At} g gᵀ e^{Aᵀt} dt, Van Loan (1978)."""
    N = A.shape[-1]
    block = np.zeros((len(A), 2 * N, 2 * N))
    block[:, :N, :N] = -A
    block[:, :N, N:] = noise @ np.swapaxes(noise, 1, 2)
    block[:, N:, N:] = np.swapaxes(A, 1, 2)
    # The intensities are taken out, so that the series sees entries of size one.
    size = np.max(np.abs(block[:, :N, N:]), axis=(1, 2), keepdims=True)
    block[:, :N, N:] /= size
    whole = exponential(block)
    Phi = np.swapaxes(whole[:, N:, N:], 1, 2)
    Q = Phi @ whole[:, :N, N:]
    return Phi, np.sqrt(size) * np.linalg.cholesky(0.5 * (Q + np.swapaxes(Q, 1, 2)))


def exponential(X: Array) -> Array:
    """Return e^X for a batch (B,n,n): Taylor's series to degree 16 in powers of X⁴, after halving X often enough."""
    largest = float(np.max(np.sum(np.abs(X), axis=1)))
    squarings = max(0, ceil(np.log2(max(largest, 1e-300))) + 1)
    X = X / 2.0**squarings
    powers = [np.broadcast_to(np.eye(X.shape[-1]), X.shape), X, X @ X]
    powers.append(powers[2] @ X)
    fourth = powers[2] @ powers[2]
    result = powers[0] / factorial(_TAYLOR_TERMS)
    for first in range(_TAYLOR_TERMS - 4, -1, -4):
        result = fourth @ result + sum(powers[i] / factorial(first + i) for i in range(4))
    for _ in range(squarings):
        result = result @ result
    return result


def _updated(factor: Array, C: Array, R_factor: Array) -> tuple[Array, Array, Array]:
    """Return the factors of S (B,p,p), of P⁻Cᵀ over S's (B,N,p) and of P (B,N,N)."""
    batch, p, N = len(factor), R_factor.shape[1], C.shape[1]
    rows = np.zeros((batch, p + N, p + N))
    rows[:, :p, :p] = R_factor
    rows[:, :p, p:] = C @ factor
    rows[:, p:, p:] = factor
    lower = _triangular(rows)
    return lower[:, :p, :p], lower[:, p:, :p], lower[:, p:, p:]


def _triangular(rows: Array) -> Array:
    return np.swapaxes(np.linalg.qr(np.swapaxes(rows, 1, 2), mode="r"), 1, 2)


def _runge_kutta(slope: Callable[[Array], Array], x: Array, h: float, substeps: int) -> Array:
    for _ in range(substeps):
        k1 = slope(x)
        k2 = slope(x + 0.5 * h * k1)
        k3 = slope(x + 0.5 * h * k2)
        x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + slope(x + h * k3))
    return x


def extended_state_observer(
    order: int,
    H: float,
    samples: Array,
    *,
    bandwidth: Array,
    stiffness: float,
    damping: float,
    start: tuple[float, float],
) -> Estimates:
    """Run the linear extended state observer of the motor equation, with all poles at one bandwidth (B,) in rad/s.

        φ̈ = k (θ − φ) − c φ̇ + d,   d^{(r)} = 0          z = [φ; φ̇; d; ḋ; …]; r = 1 is the classical one

    samples (B,K,2) are [φ, θ]; θ runs straight between two samples. The discrete observer corrects its prediction with
    the sample that has just come, and the eigenvalues of (I − K C) Φ are all e^{−ωH} (Miklosovic, Radke and Gao, 2006).
    start: φ̂ and φ̇̂ at t₀.
    """
    N = 2 + order
    scale = H ** -np.arange(N, dtype=float)  # in time by H all entries are of size one
    A = np.eye(N, k=1)
    A[1, :2] = -stiffness * H**2, -damping * H
    channel = np.zeros(N)
    channel[1] = stiffness * H**2
    # [A b 0; 0 0 1; 0 0 0]: an input that runs straight from θ_k, by its rise over the step.
    joined = np.zeros((1, N + 2, N + 2))
    joined[0, :N, :N], joined[0, :N, N], joined[0, N, N + 1] = A, channel, 1.0
    sampled = exponential(joined)[0]
    Phi, from_start, from_rise = sampled[:N, :N], sampled[:N, N], sampled[:N, N + 1]
    C = np.eye(N)[0]
    rows = [C @ np.linalg.matrix_power(Phi, i + 1) for i in range(N)]
    last_column = np.linalg.solve(np.array(rows), np.eye(N)[:, -1])
    # Ackermann's formula.
    K = np.array([np.linalg.matrix_power(Phi - z * np.eye(N), N) @ last_column for z in np.exp(-bandwidth * H)])

    batch, count, _ = samples.shape
    z = np.tile(np.concatenate([start, np.zeros(order)]) / scale, (batch, 1))
    at_sample, ahead = np.empty((2, batch, count, 1))
    for k in range(count):
        angle, link = samples[:, k, 0], samples[:, k, 1]
        if k > 0:
            before = samples[:, k - 1, 1]
            z = z @ Phi.T + before[:, None] * from_start + (link - before)[:, None] * from_rise
        z = z + K * (angle - z @ C)[:, None]
        at_sample[:, k, 0] = z[:, 2] * scale[2]
        ahead[:, k, 0] = scale[2] * sum(z[:, 2 + i] / factorial(i) for i in range(order))
    return Estimates(at_sample, ahead, (K * scale)[:, :, None])


def second_difference(H: float, samples: Array, *, stiffness: float, damping: float) -> Estimates:
    """Solve the motor equation for d with central differences of the three latest samples [φ, θ], (B,K,2).

        d̂ = (φ_k − 2 φ_{k−1} + φ_{k−2})/H² + c (φ_k − φ_{k−2})/(2H) + k (φ_{k−1} − θ_{k−1})

    It is d one sample ago, exact where φ is a quadratic polynomial there, and serves as the estimate of now and of the
    step's end; 0 before there are three samples.
    """
    motor, link = samples[:, :, 0], samples[:, :, 1]
    d_hat = np.zeros((*motor.shape, 1))
    new, middle, old = motor[:, 2:], motor[:, 1:-1], motor[:, :-2]
    d_hat[:, 2:, 0] = (new - 2.0 * middle + old) / H**2 + damping * (new - old) / (2.0 * H)
    d_hat[:, 2:, 0] += stiffness * (middle - link[:, 1:-1])
    return Estimates(d_hat, d_hat, np.zeros((len(samples), 0, 2)))
