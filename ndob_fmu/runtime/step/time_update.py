"""The time update: ξ̂ and its covariance from a sample to the end of the step.

x̂' = A x̂ + B u + G_f f(x̂, u) + G_d d̂(t),   d̂⁽ʳ⁾ = 0,   from t to t + H
"""

from __future__ import annotations

from math import factorial

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.augmented import discretise
from ndob_fmu.runtime.design.stationary_design import scaled_noise
from ndob_fmu.runtime.design.step_designs import StepDesign
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.numerics.kalman import predict
from ndob_fmu.runtime.numerics.stiff import integrate_any


def predict_state(equations: Equations, parameters: Vector, xi_hat: Array, held: Array, u: Vector, H: float) -> Array:
    """Return ξ̂⁻ (N,) a step H (s) after ξ̂ (N,), by the plant's equations with d continued by its Taylor series.

    held (q2,): d over the step for r = 0, where ξ̂ has no disturbance.
    """
    n, q = len(equations.states), len(held)
    r = (len(xi_hat) - n) // q
    series = xi_hat[n:].reshape(r, q) if r else held[None]

    def taylor(rows: Array, t: float) -> Array:
        return np.asarray(sum((row * t**i / factorial(i) for i, row in enumerate(rows)), np.zeros(q)))

    def derivatives(t: float, x: Array) -> Array:
        return np.array(equations.derivatives(x.tolist(), u, taylor(series, t).tolist(), parameters), dtype=float)

    def slopes(t: float, x: Array) -> tuple[Array, Array]:
        return equations.slopes(x.tolist(), u, taylor(series, t).tolist(), taylor(series[1:], t), parameters)

    x_after, _ = integrate_any(derivatives, slopes, xi_hat[:n], H, H)
    later = [sum((series[j] * H ** (j - i) / factorial(j - i) for j in range(i, r)), np.zeros(q)) for i in range(r)]
    return np.concatenate([x_after, *later])


def predict_covariance(factor: Array, design: StepDesign, H: float, *, starting: bool) -> Array:
    """Return the covariance's factor (N,N) a step H (s) after a factor (N,N), with what f(x) − f(x̂) may do meanwhile.

    That is at most γ times the error of f's states, as far as it exceeds the converged one, which the intensities
    cover: a state that only the plant's zeros forget keeps f wrong long after the others are known. Where γ is so large
    that this bound would never decay, it counts during the start-up (`starting`) only.
    """
    stationary = design.stationary
    discrete, noise_factor = stationary.discrete, stationary.noise_factor
    if discrete.H != H:
        discrete = discretise(stationary.system, H, stationary.alpha)
        noise_factor = scaled_noise(discrete, stationary.intensities)
    ahead = predict(factor, discrete.filter_phi, noise_factor)
    if not starting and not design.f_error_fades:
        return ahead
    f_states = list(design.f_states)
    excess = np.sum(ahead[f_states] ** 2) - np.sum(stationary.prior_factor[f_states] ** 2)
    f_error = design.known.lipschitz * float(np.sqrt(max(excess, 0.0)))
    return predict(ahead, np.eye(len(ahead)), f_error * discrete.held_f)
