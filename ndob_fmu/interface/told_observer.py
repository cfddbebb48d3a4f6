"""The sampled-data observer that the start values of `<Name>Observer` ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from ndob_fmu.interface.model_variables import for_each_disturbance
from ndob_fmu.runtime.design.lumping import lumped, lumped_bound, lumped_nominal, lumped_rate
from ndob_fmu.runtime.design.ranges import continued
from ndob_fmu.runtime.design.separability import inseparable_offsets, inseparable_parameters
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.step.sampled_observer import SampledObserver, sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings

Value = Callable[[str], Any]
Warn = Callable[[str], None]


def told_observer(equations: Equations, value: Value, warn: Warn) -> SampledObserver:
    """Return the observer; a channel that depends on the state is lumped into its bound.

    value: value(name) is that of a parameter of `observer_variables`
    warn: takes a line about offsets and parameters that cannot be told from a disturbance

    Raises DesignError for values outside their ranges, AssumptionError where the plant has no observer for them.
    """
    plant, parameters = continued(lumped(equations)), values_of(value, equations.parameters)
    order = value("disturbance_order")
    bound, rate = (for_disturbances(equations, value, name) for name in ("disturbance_bound", "disturbance_rate"))
    x_hat, x_std = (values_of(value, equations.states, suffix) for suffix in ("_hat_start", "_hat_start_std"))
    sensors = {name: values_of(value, equations.outputs, f"_{name}") for name in ("noise_std", "delay", "bias_std")}
    parameter_std = values_of(value, plant.parameters, "_std")
    _warn_of_offsets(equations, plant, parameters, x_hat, sensors["bias_std"], warn)
    wanted = [value("estimate_parameters") and std > 0.0 for std in parameter_std]
    settings = observer_settings(
        plant,
        **sensors,
        order=order,
        own_order=_own_order(equations, plant, value),
        disturbance_bound=lumped_bound(equations, bound),
        disturbance_nominal=lumped_nominal(equations, for_disturbances(equations, value, "disturbance_nominal")),
        disturbance_rate=lumped_rate(equations, bound, rate, order=order),
        x_std=x_std,
        parameter_std=parameter_std,
        adapt_noise=value("adapt_noise"),
        estimated=_estimated(equations, plant, parameters, x_hat, x_std, wanted, warn),
        lag=value("lag"),
        alpha=value("alpha"),
        pi=value("pi_end"),
    )
    return sampled_observer(plant, parameters, settings, x_hat)


def _own_order(equations: Equations, plant: Equations, value: Value) -> list[int]:
    """Return the order of each disturbance that the observer estimates; 0: as `disturbance_order`."""
    if len(equations.disturbances) == 1:
        return [0] * len(plant.disturbance_bound)
    return [int(one) for one in for_disturbances(equations, value, "disturbance_own_order")]


def for_disturbances(equations: Equations, value: Value, name: str) -> list[float]:
    """Return the parameter `name` of each disturbance."""
    return [value(own) for own in for_each_disturbance(name, equations.disturbances).values()]


def values_of(value: Value, names: Iterable[str], suffix: str = "") -> list[float]:
    """Return the parameters of names with a suffix."""
    return [value(f"{name}{suffix}") for name in names]


def _warn_of_offsets(
    equations: Equations, plant: Equations, parameters: Vector, x_hat: Vector, bias_std: Vector, warn: Warn
) -> None:
    biased = [i for i, std in enumerate(bias_std) if std > 0.0]
    for i in inseparable_offsets(plant, parameters, x_hat, biased) if biased else ():
        name, disturbances = plant.outputs[i], " or ".join(equations.disturbances)
        warn(
            f"{name}_bias_std: in the outputs a constant offset of {name} looks like a constant {disturbances} or "
            f"another offset; the samples cannot tell them apart"
        )


def _estimated(
    equations: Equations,
    plant: Equations,
    parameters: Vector,
    x_hat: Vector,
    x_std: Vector,
    wanted: Sequence[bool],
    warn: Warn,
) -> list[bool]:
    """Return which of the wanted parameters are estimated: not those that cannot be told from a disturbance."""
    estimated, uncertain = list(wanted), [i for i, one in enumerate(wanted) if one]
    names, disturbances = list(plant.parameters), " or ".join(equations.disturbances)
    for i in inseparable_parameters(plant, parameters, x_hat, x_std, uncertain) if uncertain else ():
        estimated[i] = False
        warn(
            f"estimate_parameters: {names[i]} is not estimated, because a wrong one has the effect of a "
            f"{disturbances}; {names[i]}_std widens the error bars only"
        )
    return estimated
