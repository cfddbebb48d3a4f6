"""What the sampled-data observer is told: about its sensors, the disturbance, the model and what to estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector

ORDERS = tuple(range(HIGHEST_ORDER + 1))


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

    def positive(values: Vector) -> bool:
        return bool(np.all(np.isfinite(values)) and np.all(np.array(values) > 0.0))

    def not_negative(values: Vector) -> bool:
        return bool(np.all(np.isfinite(values)) and np.all(np.array(values) >= 0.0))

    sensors = settings.sensors
    _require("disturbance_order", settings.order in ORDERS, "0, 1, 2 or 3", settings.order)
    _require("alpha", positive([settings.alpha]), "a finite number > 0", settings.alpha)
    _require("pi_end", positive([settings.pi]), "a finite number > 0", settings.pi)
    _require(
        "disturbance_nominal",
        bool(np.all(np.isfinite(settings.disturbance_nominal)))
        and (settings.order > 0 or not any(settings.disturbance_nominal)),
        "finite numbers, and 0 with disturbance_order 0",
        np.array(settings.disturbance_nominal),
    )
    _require("lag", not_negative([settings.lag]), "a finite number ≥ 0", settings.lag)
    for name, values in (
        ("disturbance_bound", settings.disturbance_bound),
        ("hat_start_std", settings.x_std),
    ):
        _require(name, positive(values), "finite numbers > 0", np.array(values))
    for name, values in (
        ("noise_std", sensors.noise_std),
        ("delay", sensors.delay),
        ("bias_std", sensors.bias_std),
        ("disturbance_rate", settings.disturbance_rate),
        ("parameter_std", settings.parameter_std),
        ("state_noise", settings.state_noise),
    ):
        _require(name, not_negative(values), "finite numbers ≥ 0", np.array(values))


def _require(name: str, condition: bool, expected: str, received: object) -> None:
    if not condition:
        raise DesignError.report(name, expected=expected, received=str(received))
