"""The stationary sampled-data gain at a step H and given noise, and the noise and the bias of d̂ that it predicts."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.augmented import Augmented, Discrete, discretise
from ndob_fmu.runtime.numerics.exponential import exponential
from ndob_fmu.runtime.numerics.kalman import (
    Update,
    converged_factor,
    forward,
    stationary,
    triangular,
    update,
    whitening,
)
from ndob_fmu.runtime.numerics.units import units_of_inputs


@dataclass(frozen=True)
class Intensities:
    """White noise that the design assumes. A noise of intensity s, averaged over a step H, has the variance s/H.

    disturbance (q_d,): intensities on w_d, on all of G for r = 0.
    f (q_f,): intensities on the channels of `Augmented.f_noise`; empty for r = 0, where f's are in `disturbance`.
    scale: factor on the standard deviations of all noises, that of the samples included. It leaves the converged gain
    as it is, and sets the weight of the noise against the uncertainty at the start.
    """

    disturbance: Array
    f: Array
    scale: float = 1.0


@dataclass(frozen=True)
class StationaryDesign:
    """The stationary design, N = n + r q2.

    system, discrete: the model, continuous and sampled.
    intensities: the noise on it.
    alpha: α of the paper (1/s), used for r = 0 only.
    noise_factor (N,·): of the covariance of the noise over a step, times `intensities.scale`.
    R_factor (p,p): R_factor R_factorᵀ is the covariance of the noise of a sample.
    sample_factor (p,p): R_factor times `intensities.scale`.
    prior_factor (N,N): of the converged covariance P⁻ before a sample.
    update: the measurement update there, with the gain K (N,p).
    M_H (q2,p): d̂ = M_H e for r = 0, exact at DC; None for r ≥ 1, where d̂ is part of ξ̂.
    whitened: the filter in coordinates in which its covariance is I.
    """

    system: Augmented
    discrete: Discrete
    intensities: Intensities
    alpha: float
    noise_factor: Array = field(repr=False)
    R_factor: Array = field(repr=False)
    sample_factor: Array = field(repr=False)
    prior_factor: Array = field(repr=False)
    update: Update = field(repr=False)
    M_H: Array | None
    whitened: Whitened = field(repr=False)

    @property
    def K(self) -> Array:
        """The stationary gain, (N,p)."""
        return self.update.K

    @property
    def error_dynamics(self) -> Array:
        """F (N,N) of the error after the update, ξ̃⁺ = F ξ̃ + …: (I − K C) Φ; its eigenvalues are the filter's poles."""
        return (np.eye(len(self.K)) - self.K @ self.system.C) @ self.discrete.Phi

    @property
    def poles(self) -> NDArray[np.complex128]:
        """The filter's poles (N,), in the z plane."""
        return np.asarray(np.linalg.eigvals(self.whitened.after_sample)).astype(complex)

    def noise_std(self, *, ahead: bool = False) -> Array:
        """Return the standard deviation (q2,) that sample noise gives d̂, at the sample or a step `ahead` of it."""
        z = self.whitened
        if self.M_H is not None:
            return np.asarray(np.linalg.norm(self.M_H @ self._innovation_noise(), axis=1))
        factor = converged_factor(z.after_sample, z.gain / self.intensities.scale)
        selector = z.selector @ (z.step if ahead else z.update)
        return np.asarray(np.linalg.norm(selector @ factor, axis=1))

    def innovation_noise_std(self) -> Array:
        """Return the standard deviation (p,) that sample noise gives y − C ξ̂⁻ once the gain has converged."""
        return np.asarray(np.linalg.norm(self._innovation_noise(), axis=1))

    def _innovation_noise(self) -> Array:
        z = self.whitened
        factor = converged_factor(z.after_sample, z.gain / self.intensities.scale)
        return np.hstack([z.C @ z.step @ factor, self.R_factor])

    def bias_gain(self, *, ahead: bool = False) -> Array:
        """Return |E| (q2,q2): the constant error of d̂_i where d_j's r-th derivative (the first, for r = 0) is one."""
        z = self.whitened
        if self.M_H is not None:
            # A step later d̂ is still the one read at the sample.
            lag = self.discrete.H * np.eye(len(self.M_H)) if ahead else 0.0
            return np.abs(self.M_H @ z.C @ self._ramp_error() - lag)
        error = z.settled(forward(z.T, self.discrete.drive))
        return np.asarray(np.abs(z.selector @ (error if ahead else z.update @ z.update.T @ error)))

    @cached_property
    def steady_innovation(self) -> Array:
        """Return the steady |y − C ξ̂⁻| (p,q2) for an r-th derivative of d of one, for d = 1 where r = 0."""
        z = self.whitened
        source = self.discrete.drive if self.system.order else self.discrete.held_disturbance
        return np.asarray(np.abs(z.C @ z.settled(forward(z.T, source))))

    def _ramp_error(self) -> Array:
        """Return b (n,q2) of the error before the update for r = 0 and d = t in one channel each, x̃⁻ = a t/H + b."""
        z, H, linear = self.whitened, self.discrete.H, self.system.linear
        n, q_d = linear.G_d.shape
        # Over a step the ramp adds the integral of e^{A(H−s)} G s, which is the drive of a doubly integrated channel.
        chain = np.zeros((n + 2 * q_d, n + 2 * q_d))
        chain[:n, :n], chain[:n, n : n + q_d] = linear.A, linear.G_d
        chain[n : n + q_d, n + q_d :] = np.eye(q_d)
        of_d = units_of_inputs(chain[:n, n : n + q_d] * H, self.system.units)
        units = np.concatenate([self.system.units, of_d, units_of_inputs(H * np.eye(q_d), of_d)])
        sampled = forward(z.T, exponential(chain * H, units)[:n])
        from_d, from_rate = sampled[:, n : n + q_d], sampled[:, n + q_d :]
        return z.settled(from_rate - z.settled(from_d * H))


@dataclass(frozen=True)
class Whitened:
    """The filter in coordinates z in which its covariance is I, where solving loses no digits.

    The error is T z⁻ before a sample with the noise sample_factor v, and T update z after it, z = updateᵀ z⁻ − gain v;
    a step later z⁻ = step z. Both covariances are I, so that update and step are contractions;
    I − K C = T update updateᵀ T⁻¹ is computed without a difference of large numbers.

    T, update, step (N,N) and gain (N,p): as above.
    C (p,N), selector (q2,N): act on z⁻.
    """

    T: Array
    update: Array
    step: Array
    gain: Array
    C: Array
    selector: Array

    @property
    def after_sample(self) -> Array:
        """(I − K C) Φ (N,N), from z to z."""
        return np.asarray(self.update.T @ self.step)

    @property
    def before_sample(self) -> Array:
        """Φ (I − K C) (N,N), from z⁻ to z⁻."""
        return np.asarray(self.step @ self.update.T)

    def settled(self, added: Array) -> Array:
        """Return z⁻ (N,·), to which the error converges where every step adds `added` (N,·) to it."""
        return np.asarray(np.linalg.solve(np.eye(len(self.T)) - self.before_sample, added), dtype=float)


def _whitened(system: Augmented, discrete: Discrete, sample_factor: Array, prior_factor: Array) -> Whitened:
    T = whitening(prior_factor)
    driven = np.any(prior_factor, axis=1)  # the gain corrects no other state, although it may be seen
    seen = np.linalg.solve(sample_factor, system.C @ T) * driven
    p, N = seen.shape
    after = triangular(np.block([[np.eye(p), seen], [np.zeros((N, p)), np.eye(N)]]))[p:, p:]
    selector = np.zeros((0, N)) if system.selector is None else system.selector
    return Whitened(
        T=T,
        update=after,
        step=forward(T, discrete.Phi @ T @ after),
        gain=after.T @ seen.T,
        C=system.C @ T,
        selector=selector @ T,
    )


def stationary_design(
    system: Augmented, H: float, R_factor: Array, intensities: Intensities, alpha: float
) -> StationaryDesign:
    """Design the stationary gain for a step H > 0 s. Raises DesignError where none can be found."""
    return design_for(system, discretise(system, H, alpha), R_factor, intensities, alpha)


def design_for(
    system: Augmented,
    discrete: Discrete,
    R_factor: Array,
    intensities: Intensities,
    alpha: float,
    similar_factor: Array | None = None,
) -> StationaryDesign:
    """Design the stationary gain for a step that is sampled already.

    similar_factor: `prior_factor` (N,N) of a design for other intensities, which saves time

    Raises DesignError where none can be found.
    """
    noise_factor, sample_factor = scaled_noise(discrete, intensities), intensities.scale * R_factor
    prior_factor = stationary(
        discrete.filter_phi,
        system.C,
        noise_factor,
        sample_factor,
        similar_factor,
        intensities.scale * system.units,
    )
    z = _whitened(system, discrete, sample_factor, prior_factor)
    return StationaryDesign(
        system=system,
        discrete=discrete,
        intensities=intensities,
        alpha=alpha,
        noise_factor=noise_factor,
        R_factor=R_factor,
        sample_factor=sample_factor,
        prior_factor=prior_factor,
        update=update(prior_factor, system.C, sample_factor),
        M_H=_dc_inverse(system, discrete, z, R_factor) if system.order == 0 else None,
        whitened=z,
    )


def scaled_noise(discrete: Discrete, intensities: Intensities) -> Array:
    """Return the factor (N,·) of the process noise's covariance over one step."""
    of_d, of_f = discrete.noise_factor, discrete.f_noise_factor
    noise = np.hstack([_sized(of_d, intensities.disturbance), _sized(of_f, intensities.f)])
    return np.asarray(intensities.scale * noise)


def _sized(factor: Array, intensities: Array) -> Array:
    """Return a factor (N,·) of noise of such intensities (q,) from one per unit of them."""
    return np.asarray(factor * np.tile(np.sqrt(intensities), factor.shape[1] // max(len(intensities), 1)))


def _dc_inverse(system: Augmented, discrete: Discrete, z: Whitened, R_factor: Array) -> Array:
    """Return M_H (q2,p): the rows for d of [C (I − Φ (I − K C))⁻¹ Γ]⁻¹, the left inverse where p > q.

    It is the inverse for outputs in units of their noise.
    """
    innovations = np.asarray(np.linalg.solve(R_factor, z.C @ z.settled(forward(z.T, discrete.drive))), dtype=float)
    units = units_of_inputs(innovations, np.ones(len(innovations)))
    inverse = units[:, None] * np.linalg.pinv(innovations * units)
    return np.asarray(system.linear.selector @ np.linalg.solve(R_factor.T, inverse.T).T)
