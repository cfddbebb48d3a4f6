"""The sampled-data gain at a step H and given noise, and what it promises: noise and bias of d̂."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ndob_fmu.runtime.augmented import Augmented, Discrete, discretise
from ndob_fmu.runtime.exponential import exponential
from ndob_fmu.runtime.kalman import Update, covariance_of, stationary, update
from ndob_fmu.runtime.riccati import Array


@dataclass(frozen=True)
class Intensities:
    """White noise that the design assumes: `disturbance` (q_d,) on w_d (on all of G for r = 0), `f` on f's channel.

    Intensity is variance times time: a noise of intensity s, averaged over a step H, has the variance s/H.
    """

    disturbance: Array
    f: float


@dataclass(frozen=True)
class SampledDesign:
    """The stationary design. N = n + r q2; R = R_factor R_factorᵀ (p,p) is the noise of a sample.

    prior_factor (N,N): of the covariance P⁻ before a sample; rest: the update there, with the gain K (N,p);
    M_H (q2,p): d̂ = M_H e for r = 0, exact at DC; None for r ≥ 1, where d̂ is part of ξ̂.
    """

    system: Augmented
    discrete: Discrete
    intensities: Intensities
    noise_factor: Array = field(repr=False)
    R_factor: Array = field(repr=False)
    prior_factor: Array = field(repr=False)
    rest: Update = field(repr=False)
    M_H: Array | None

    @property
    def K(self) -> Array:
        """The stationary gain, (N,p)."""
        return self.rest.K

    @property
    def error_dynamics(self) -> Array:
        """F (N,N) of the error after the update, ξ̃⁺ = F ξ̃ + …: (I − K C) Φ; its eigenvalues are the filter's poles."""
        return (np.eye(len(self.K)) - self.K @ self.system.C) @ self.discrete.Phi

    def noise_std(self, *, ahead: bool = False) -> Array:
        """Return the standard deviation (q2,) that sample noise gives d̂, at the sample or a step `ahead` of it."""
        scale, F, K, C, select = self._scaled()
        noise = K @ self.R_factor
        X = covariance_of(F, noise)
        if self.M_H is not None:
            Phi = self.discrete.Phi * scale / scale[:, None]
            S = C @ Phi @ X @ Phi.T @ C.T + self.R_factor @ self.R_factor.T
            return np.asarray(np.sqrt(np.diag(self.M_H @ S @ self.M_H.T)))
        if ahead:
            Phi = self.discrete.Phi * scale / scale[:, None]
            X = Phi @ X @ Phi.T
        return np.asarray(np.sqrt(np.diag(select @ X @ select.T)))

    def bias_gain(self, *, ahead: bool = False) -> Array:
        """Return |E| (q2,q2): the constant error of d̂_i where d_j's r-th derivative (the first, for r = 0) is one."""
        scale, F, K, C, select = self._scaled()
        identity = np.eye(len(F))
        drive = self.discrete.drive / scale[:, None]
        if self.M_H is not None:
            return np.abs(self._ramp_error(scale, drive))
        error = np.linalg.solve(identity - F, (identity - K @ C) @ drive)
        if ahead:
            error = (self.discrete.Phi * scale / scale[:, None]) @ error + drive
        return np.asarray(np.abs(select @ error))

    @cached_property
    def usual_innovation(self) -> Array:
        """Return |y − C ξ̂⁻| (p,q2) at rest for d = 1 (r = 0) or an r-th derivative of one: what samples show of it."""
        scale, F, K, C, _ = self._scaled()
        Phi = self.discrete.Phi * scale / scale[:, None]
        identity = np.eye(len(F))
        before_update = Phi @ (identity - K @ C)
        source = self.discrete.drive if self.system.order else self.discrete.held_disturbance
        return np.asarray(np.abs(C @ np.linalg.solve(identity - before_update, source / scale[:, None])))

    def _ramp_error(self, scale: Array, drive: Array) -> Array:
        """Return d̂ − d (q2,q2) for r = 0 and d = t in one channel each: x̃⁻ = a t/H + b follows its own recursion."""
        system, H = self.system, self.discrete.H
        K, C = self.K / scale[:, None], system.C * scale
        Phi = self.discrete.Phi * scale / scale[:, None]
        identity = np.eye(len(Phi))
        F = Phi @ (identity - K @ C)
        linear = system.linear
        n, q_d = linear.G_d.shape
        # Over a step the ramp adds the integral of e^{A(H−s)} G s, which is the drive of a doubly integrated channel.
        chain = np.zeros((n + 2 * q_d, n + 2 * q_d))
        chain[:n, :n], chain[:n, n : n + q_d] = linear.A, linear.G_d
        chain[n : n + q_d, n + q_d :] = np.eye(q_d)
        sampled = exponential(chain * H)[:n]
        from_d, from_rate = sampled[:, n : n + q_d], sampled[:, n + q_d :]
        a = np.linalg.solve(identity - F, from_d / scale[:, None] * H)
        b = np.linalg.solve(identity - F, from_rate / scale[:, None] - a)
        assert self.M_H is not None
        return np.asarray(self.M_H @ C @ b)

    def _scaled(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return scale, F, K, C and the selector in states of size one, where solving loses no digits."""
        scale = np.linalg.norm(self.rest.factor, axis=1)
        scale = np.where(scale > 0.0, scale, 1.0)
        select = self.system.selector if self.system.selector is not None else np.zeros((0, len(scale)))
        return (
            scale,
            self.error_dynamics * scale / scale[:, None],
            self.K / scale[:, None],
            self.system.C * scale,
            select * scale,
        )


def sampled_design(
    system: Augmented, H: float, R_factor: Array, intensities: Intensities, alpha: float
) -> SampledDesign:
    """Design the stationary gain for a step H > 0 s. Raises DesignError where it cannot be found."""
    discrete = discretise(system, H, alpha)
    noise_factor = scaled_noise(discrete, intensities)
    prior_factor = stationary(discrete.filter_phi, system.C, noise_factor, R_factor)
    rest = update(prior_factor, system.C, R_factor)
    return SampledDesign(
        system=system,
        discrete=discrete,
        intensities=intensities,
        noise_factor=noise_factor,
        R_factor=R_factor,
        prior_factor=prior_factor,
        rest=rest,
        M_H=_dc_inverse(system, discrete, rest.K) if system.order == 0 else None,
    )


def scaled_noise(discrete: Discrete, intensities: Intensities) -> Array:
    """Return the factor (N,·) of the process noise's covariance over one step."""
    repeats = discrete.noise_factor.shape[1] // len(intensities.disturbance)
    columns = np.tile(np.sqrt(intensities.disturbance), repeats)
    return np.hstack([discrete.noise_factor * columns, np.sqrt(intensities.f) * discrete.f_noise_factor])


def _dc_inverse(system: Augmented, discrete: Discrete, K: Array) -> Array:
    """Return M_H (q2,p): the rows for d of [C (I − Φ (I − K C))⁻¹ Γ]⁻¹, the left inverse where p > q."""
    identity = np.eye(len(K))
    response = system.C @ np.linalg.solve(identity - discrete.Phi @ (identity - K @ system.C), discrete.drive)
    return np.asarray(system.linear.selector @ np.linalg.pinv(response))
