"""The settings that are tuned by hand, as start values of the observer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ndob_fmu.errors import UsageError
from ndob_fmu.interface.model_variables import for_each_disturbance
from ndob_fmu.log.fit.fit_log import FIT
from ndob_fmu.log.told_values import start_values_text
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.support.files import atomic_path


@dataclass(frozen=True)
class Settings:
    """What the page sets.

    noise_std (p,): of each output; rate (q2,): of each disturbance, per s^order
    order: of the disturbance; lag: of the lagged estimate (s)
    adapt_noise: whether the noise follows the residuals
    """

    noise_std: tuple[float, ...]
    order: int
    rate: tuple[float, ...]
    lag: float
    adapt_noise: bool

    def start_values(self, equations: Equations) -> dict[str, Any]:
        """Return them by the names of the observer's parameters."""
        return {
            **dict(zip(noise_names(equations), self.noise_std, strict=True)),
            "disturbance_order": self.order,
            **dict(zip(rate_names(equations), self.rate, strict=True)),
            "lag": self.lag,
            "adapt_noise": self.adapt_noise,
        }


def settings_of(equations: Equations, values: Mapping[str, Any]) -> Settings:
    """Return the settings among the values of all parameters.

    Raises UsageError for a noise or a rate of 0, which a logarithmic scale does not have.
    """
    for name in (*noise_names(equations), *rate_names(equations)):
        if not values[name] > 0.0:
            raise UsageError.report(
                f"start value of {name}", expected="a number above 0 for tune", received=f"{values[name]:g}"
            )
    return Settings(
        noise_std=tuple(float(values[name]) for name in noise_names(equations)),
        order=int(values["disturbance_order"]),
        rate=tuple(float(values[name]) for name in rate_names(equations)),
        lag=float(values["lag"]),
        adapt_noise=bool(values["adapt_noise"]),
    )


def save(folder: Path, start_values: Mapping[str, Any]) -> Path:
    """Write start values as `fit` does; return the path. Raises UsageError if the folder cannot be written."""
    path = folder / FIT
    with atomic_path(path) as new:
        new.write_text(start_values_text(start_values), "utf-8")
    return path


def noise_names(equations: Equations) -> list[str]:
    """Return the parameters of the outputs' noise."""
    return [f"{name}_noise_std" for name in equations.outputs]


def rate_names(equations: Equations) -> list[str]:
    """Return the parameters of the disturbances' rates."""
    return list(for_each_disturbance("disturbance_rate", equations.disturbances).values())
