"""What the sampled-data observer is told: about its sensors, the disturbance, the model and what to estimate."""

from __future__ import annotations

from dataclasses import dataclass

from ndob_fmu.runtime.equations import Equations, Vector


@dataclass(frozen=True)
class Sensors:
    """The sensors, one entry for each output (p,), in its unit.

    noise_std: σ ≥ 0 of a sample; 0 for no noise
    delay: age ≥ 0 (s) of a sample when it arrives
    bias_std: standard deviation ≥ 0 of a constant offset; 0 for none
    """

    noise_std: Vector
    delay: Vector
    bias_std: Vector


@dataclass(frozen=True)
class ObserverSettings:
    """The settings of `sampled_observer`.

    order: r = 0 … 3
    sensors: as above
    disturbance_bound (q2,): D₀ > 0, the bound of |d|
    disturbance_rate (q2,): ≥ 0, the bound of |d^{(r)}|, of |ḋ| for r = 0; with 0 the pace follows from `pi`
    x_std (n,): > 0, the standard deviation of the error of x̂₀
    parameter_std: one-sigma uncertainty of each parameter, 0 where it is known
    state_noise (n,): intensity of white noise on ẋ, as a standard deviation per √s; 0 for none
    adapt_noise: whether the variance of each output's noise follows the innovations
    estimate_parameters: whether uncertain parameters are estimated, not only considered
    lag: how long before the sample the lagged estimate is (s)
    alpha, pi: α (1/s), which r = 0 needs, and π, which sets the pace where a rate is 0
    """

    order: int
    sensors: Sensors
    disturbance_bound: Vector
    disturbance_rate: Vector
    x_std: Vector
    parameter_std: Vector
    state_noise: Vector
    adapt_noise: bool
    estimate_parameters: bool
    lag: float
    alpha: float
    pi: float


def observer_settings(
    equations: Equations,
    *,
    order: int | None = None,
    noise_std: Vector | None = None,
    delay: Vector | None = None,
    bias_std: Vector | None = None,
    disturbance_bound: Vector | None = None,
    disturbance_rate: Vector | None = None,
    x_std: Vector | None = None,
    parameter_std: Vector | None = None,
    state_noise: Vector | None = None,
    adapt_noise: bool = True,
    estimate_parameters: bool = False,
    lag: float = 0.0,
    alpha: float | None = None,
    pi: float | None = None,
) -> ObserverSettings:
    """Return the settings with the model's defaults for what is not given."""
    eq, tuning, none = equations, equations.observer, (0.0,) * len(equations.outputs)
    return ObserverSettings(
        order=tuning.disturbance_order if order is None else order,
        sensors=Sensors(
            noise_std=eq.noise_std if noise_std is None else noise_std,
            delay=none if delay is None else delay,
            bias_std=none if bias_std is None else bias_std,
        ),
        disturbance_bound=eq.disturbance_bound if disturbance_bound is None else disturbance_bound,
        disturbance_rate=eq.disturbance_rate if disturbance_rate is None else disturbance_rate,
        x_std=eq.xhat0_std if x_std is None else x_std,
        parameter_std=(0.0,) * len(eq.parameters) if parameter_std is None else parameter_std,
        state_noise=(0.0,) * len(eq.states) if state_noise is None else state_noise,
        adapt_noise=adapt_noise,
        estimate_parameters=estimate_parameters,
        lag=lag,
        alpha=tuning.alpha if alpha is None else alpha,
        pi=tuning.pi_end if pi is None else pi,
    )
