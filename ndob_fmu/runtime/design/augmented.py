"""The plant with its disturbance's derivatives as states, sampled at a step H: the model of method 2.

    ξ = [x; δ₁ … δ_r],   δ₁ = d,  δ_i' = δ_{i+1},  δ_r' = w_d      disturbance order r = 1, 2, 3
    ξ = x                                                          r = 0: white noise on all of G, the paper's design

White noise of intensity s drives w_d (r ≥ 1) or all of G (r = 0), and s_f drives the channels of f where these are
apart from d's.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.idle_modes import idle_directions
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.exponential import exponential
from ndob_fmu.runtime.numerics.units import natural_units, units_of_inputs


@dataclass(frozen=True)
class Augmented:
    """The augmented system of ξ, N = n + r q2.

    linear: the plant's matrices.
    order: r.
    A (N,N), C (p,N): ξ' = A ξ + …, y = C ξ.
    noise (N,·): the channel of the noise of intensity s.
    f_noise (N,·): the channels of the noise of intensities s_f: those of f, then `idle_directions`.
    selector (q2,N): picks d = δ₁ out of ξ; None for r = 0, where d is read from the output error.
    units (N,): of ξ, powers of two, in which A and R^{-1/2} C are near one. Norms of A mean something only there.
    """

    linear: LinearPart
    order: int
    A: Array = field(repr=False)
    C: Array = field(repr=False)
    noise: Array = field(repr=False)
    f_noise: Array = field(repr=False)
    selector: Array | None = field(repr=False)
    units: Array = field(repr=False)


@dataclass(frozen=True)
class Discrete:
    """One step H (s): ξ⁺ = Phi ξ + drive w̄ + noise, with w̄ the constant value of w_d (of w for r = 0) over the step.

    Phi (N,N): the transition of ξ.
    filter_phi (N,N): Phi with the α of the paper's design in it (r = 0), for the gain only.
    noise_factor (N,·): of the covariance of the noise over the step, per unit of s.
    f_noise_factor (N,·): the same per unit of s_f.
    drive (N,q_d): what w̄ = 1 adds to ξ.
    held_disturbance (n,q2): what d = 1 over the step adds to x.
    held_f (N,q1): what f = 1 over the step adds to ξ.
    """

    H: float
    Phi: Array = field(repr=False)
    filter_phi: Array = field(repr=False)
    noise_factor: Array = field(repr=False)
    f_noise_factor: Array = field(repr=False)
    drive: Array = field(repr=False)
    held_disturbance: Array = field(repr=False)
    held_f: Array = field(repr=False)


def augment(linear: LinearPart, order: int, noise_std: Array | None = None) -> Augmented:
    """Return the augmented system of disturbance order r = 0 … 3; noise_std (p,): of a sample, ones if None."""
    n, q = linear.G_d.shape
    noise_std = np.ones(len(linear.C)) if noise_std is None else noise_std
    if order == 0:
        units = natural_units(linear.A, linear.C / noise_std[:, None])
        return Augmented(linear, 0, linear.A, linear.C, linear.G, np.zeros((n, 0)), None, units)
    N = n + order * q
    A = np.zeros((N, N))
    A[:n, :n] = linear.A
    A[:n, n : n + q] = linear.G_d
    for i in range(order - 1):
        A[n + i * q : n + (i + 1) * q, n + (i + 1) * q : n + (i + 2) * q] = np.eye(q)
    C = np.hstack([linear.C, np.zeros((len(linear.C), order * q))])
    f_channel = np.zeros((n, 0)) if linear.matched else linear.G_f
    units = natural_units(A, C / noise_std[:, None])
    idle = idle_directions(linear.A, np.hstack([linear.G_d, f_channel]), units[:n])
    return Augmented(
        linear=linear,
        order=order,
        A=A,
        C=C,
        noise=np.eye(N)[:, N - q :],
        f_noise=np.vstack([np.hstack([f_channel, idle]), np.zeros((order * q, f_channel.shape[1] + idle.shape[1]))]),
        selector=np.eye(N)[n : n + q],
        units=units,
    )


def discretise(system: Augmented, H: float, alpha: float) -> Discrete:
    """Sample the augmented system at H > 0 s; α (1/s) shifts the gain's model for r = 0 only (theory of eq. 8)."""
    N = len(system.A)
    shift = alpha * np.eye(N) if system.order == 0 else 0.0
    shifted = system.A + shift
    linear, units = system.linear, system.units
    n = len(linear.A)
    return Discrete(
        H=H,
        Phi=exponential(system.A * H, units),
        filter_phi=exponential(shifted * H, units),
        noise_factor=_noise_factor(shifted, system.noise, H, units),
        f_noise_factor=_noise_factor(shifted, system.f_noise, H, units),
        drive=_held(system.A, system.noise, H, units),
        held_disturbance=_held(linear.A, linear.G_d, H, units[:n]),
        held_f=np.vstack([_held(linear.A, linear.G_f, H, units[:n]), np.zeros((N - n, linear.G_f.shape[1]))]),
    )


def _held(A: Array, channel: Array, H: float, units: Array) -> Array:
    """Return ∫₀ᴴ e^{At} dt g: what an input of one, held over the step, adds to the state."""
    n, q = channel.shape
    joined = np.zeros((n + q, n + q))
    joined[:n] = np.hstack([A, channel]) * H
    return exponential(joined, np.concatenate([units, units_of_inputs(joined[:n, n:], units)]))[:n, n:]


def _noise_factor(A: Array, channel: Array, H: float, units: Array) -> Array:
    """Return F with F Fᵀ = ∫₀ᴴ e^{At} g gᵀ e^{Aᵀt} dt, by Gauss–Legendre quadrature of the factor itself.

    Van Loan's formula gives F Fᵀ, whose small entries (H^{2k}) are lost to rounding before a factor could be taken.
    """
    A, channel = A * units / units[:, None], channel / units[:, None]
    nodes, weights = np.polynomial.legendre.leggauss(8 + min(56, int(np.linalg.norm(A, 1) * H)))
    columns = [
        np.sqrt(0.5 * H * weight) * exponential(A * (0.5 * H * (1.0 + node))) @ channel
        for node, weight in zip(nodes, weights, strict=True)
    ]
    return np.hstack(columns) * units[:, None]
