"""What the sampled-data observer is told: about its sensors, the disturbance, the model and what to estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector


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
    own_order (q2,): r of each disturbance where it is lower; 0: r
    sensors: as above
    disturbance_bound (q2,): D₀ > 0, the bound of |d − nominal|
    disturbance_nominal (q2,): value about which d is small
    disturbance_rate (q2,): ≥ 0, the bound of |d^{(r)}|, of |ḋ| for r = 0; with 0 the pace follows from `pi`
    x_std (n,): > 0, the standard deviation of the error of x̂₀
    parameter_std: one-sigma uncertainty of each parameter, 0 where it is known
    state_noise (n,): intensity of white noise on ẋ, as a standard deviation per √s; 0 for none
    adapt_noise: whether the variance of each output's noise follows the innovations
    estimated: for each parameter, whether it is estimated where it is uncertain, not only considered
    lag: how long before the sample the lagged estimate is (s)
    alpha, pi: α (1/s), which r = 0 needs, and π, which sets the pace where a rate is 0
    """

    order: int
    own_order: Vector
    sensors: Sensors
    disturbance_bound: Vector
    disturbance_nominal: Vector
    disturbance_rate: Vector
    x_std: Vector
    parameter_std: Vector
    state_noise: Vector
    adapt_noise: bool
    estimated: Sequence[bool]
    lag: float
    alpha: float
    pi: float


def observer_settings(
    equations: Equations,
    *,
    noise_std: Vector | None = None,
    delay: Vector | None = None,
    bias_std: Vector | None = None,
    **changes: Any,
) -> ObserverSettings:
    """Return the settings that the model's start values are, but for the sensors' fields and other `changes`."""
    eq, tuning = equations, equations.observer
    defaults = ObserverSettings(
        order=tuning.disturbance_order,
        own_order=(0,) * len(eq.disturbance_bound),
        sensors=Sensors(
            noise_std=eq.noise_std if noise_std is None else noise_std,
            delay=eq.delay if delay is None else delay,
            bias_std=eq.bias_std if bias_std is None else bias_std,
        ),
        disturbance_bound=eq.disturbance_bound,
        disturbance_nominal=eq.disturbance_nominal,
        disturbance_rate=eq.disturbance_rate,
        x_std=eq.xhat0_std,
        parameter_std=eq.parameter_std,
        state_noise=eq.state_noise,
        adapt_noise=tuning.adapt_noise,
        estimated=(tuning.estimate_parameters,) * len(eq.parameters),
        lag=tuning.lag,
        alpha=tuning.alpha,
        pi=tuning.pi_end,
    )
    return replace(defaults, **changes)


def check_settings(settings: ObserverSettings) -> None:
    """Raise DesignError for settings outside their ranges."""
    sensors, order, nominal = settings.sensors, settings.order, settings.disturbance_nominal
    if order < 0 or order > HIGHEST_ORDER:
        raise DesignError.report("disturbance_order", expected="0, 1, 2 or 3", received=str(order))
    _require("alpha", "a finite number > 0", [settings.alpha])
    _require("pi_end", "a finite number > 0", [settings.pi])
    for value in nominal:
        if not isfinite(value) or (order == 0 and value != 0.0):
            expected = "finite numbers, and 0 with disturbance_order 0"
            raise DesignError.report("disturbance_nominal", expected=expected, received=f"{value:g}")
    _require("lag", "a finite number ≥ 0", [settings.lag], or_zero=True)
    _require("disturbance_bound", "finite numbers > 0", settings.disturbance_bound)
    _require("hat_start_std", "finite numbers > 0", settings.x_std)
    _require("noise_std", "finite numbers ≥ 0", sensors.noise_std, or_zero=True)
    _require("delay", "finite numbers ≥ 0", sensors.delay, or_zero=True)
    _require("bias_std", "finite numbers ≥ 0", sensors.bias_std, or_zero=True)
    _require("disturbance_rate", "finite numbers ≥ 0", settings.disturbance_rate, or_zero=True)
    _require("parameter_std", "finite numbers ≥ 0", settings.parameter_std, or_zero=True)
    _require("state_noise", "finite numbers ≥ 0", settings.state_noise, or_zero=True)


def _require(name: str, expected: str, values: Vector, *, or_zero: bool = False) -> None:
    for value in values:
        if not isfinite(value) or value < 0.0 or (value == 0.0 and not or_zero):
            raise DesignError.report(name, expected=expected, received=f"{value:g}")
