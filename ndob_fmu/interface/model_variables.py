"""The variables of the two FMUs, declared once: the slaves hold their values, the model description lists them."""

from __future__ import annotations

from collections.abc import Iterable

from ndob_fmu.interface.variables import Enumeration, Variable, parameter
from ndob_fmu.runtime.blocks.disturbance import KINDS
from ndob_fmu.runtime.equations import Equations

METHODS = {"paper": 1, "sampled_data": 2}
_TUNING = (
    *("method", "alpha", "pi_start", "pi_end", "pi_ramp_time"),
    *("disturbance_order", "adapt_noise", "estimate_parameters", "lag"),
)
_PER_DISTURBANCE = ("disturbance_bound", "disturbance_rate", "disturbance_nominal")
# Of a model with several disturbances.
OWN_ORDER = "disturbance_own_order"
_PER_STATE = ("_hat", "_start", "_hat_start", "_hat_start_std")
_PER_OUTPUT = ("_noise_std", "_delay", "_bias_std", "_residual", "_residual_std")
_OF_DISTURBANCE = ("_hat", "_at_sample", "_std", "_lagged", "_lagged_std", "_total")


METHOD = Enumeration(
    "Method",
    METHODS,
    {
        "paper": "the paper's observer, eqs. (22) to (24), integrated inside the step",
        "sampled_data": "the sampled-data design, exact at the communication points",
    },
)
DISTURBANCE_KIND = Enumeration(
    "DisturbanceKind",
    KINDS,
    {
        "none": "d = 0",
        "constant": "amplitude at all times",
        "ramp": "amplitude times the time since start_time",
        "sine": "amplitude sin(2 pi frequency (t - start_time)) from start_time on",
        "step": "amplitude from start_time on",
        "chirp": "a sine whose frequency rises from 0 to frequency in 10 s and stays there",
    },
)


def reserved_names(
    states: Iterable[str], outputs: Iterable[str], disturbances: Iterable[str], parameters: Iterable[str]
) -> list[str]:
    """Return the variable names that the FMUs derive or use themselves, so that a model cannot take them.

    A name is listed twice where it derives from two of the model's.
    """
    groups = ((states, _PER_STATE), (outputs, _PER_OUTPUT), (disturbances, _OF_DISTURBANCE), (parameters, ("_std",)))
    derived = [f"{name}{suffix}" for names, suffixes in groups for name in names for suffix in suffixes]
    return [*derived, *_TUNING, *_PER_DISTURBANCE, OWN_ORDER, "time", "valid", "consistency", "disturbance"]


def for_each_disturbance(name: str, disturbances: tuple[str, ...]) -> dict[str, str]:
    """Return each disturbance's own name for `name`: just that where there is one disturbance, else `name`.`d`."""
    if len(disturbances) == 1:
        return {disturbances[0]: name}
    return {d: f"{name}.{d}" for d in disturbances}


def plant_variables(eq: Equations) -> tuple[Variable, ...]:
    """Return the variables of `<Name>Plant`."""
    inputs = [_signal(eq, name, "input", 0.0, "Input") for name in eq.inputs]
    inputs += [
        _signal(eq, name, "input", nominal, "Disturbance, added to the generator's")
        for name, nominal in zip(eq.disturbances, eq.disturbance_nominal, strict=True)
    ]
    outputs = [
        _signal(eq, name, "output", None, "Measured output", depends_on=tuple(eq.inputs[i] for i in through))
        for name, through in zip(eq.outputs, eq.feedthrough, strict=True)
    ]
    outputs += [_signal(eq, name, "output", None, "State") for name in eq.states if name not in eq.outputs]
    outputs += [
        _output(eq, f"{name}_total", name, f"Generator plus input {name}, at the end of the step", (name,), bound)
        for name, bound in zip(eq.disturbances, eq.disturbance_bound, strict=True)
    ]
    starts = [
        parameter(f"{name}_start", value, f"Start value of {name}", unit=_unit(eq, name))
        for name, value in zip(eq.states, eq.x0, strict=True)
    ]
    generators = [variable for name in eq.disturbances for variable in _generator(eq, name)]
    return (*inputs, *outputs, *_model_parameters(eq), *starts, *generators)


def observer_variables(eq: Equations) -> tuple[Variable, ...]:
    """Return the variables of `<Name>Observer`, its outputs in the order of `Estimate`'s fields."""
    inputs = [_signal(eq, name, "input", 0.0, "Input of the plant") for name in eq.inputs]
    inputs += [_signal(eq, name, "input", 0.0, "Measured output of the plant", sampled=True) for name in eq.outputs]
    outputs = [_output(eq, f"{s}_hat", s, f"Estimate of {s} for the end of the step") for s in eq.states]
    for suffix, text, depends_on in (
        ("hat", "Estimate of {} for the end of the step", eq.outputs),
        ("at_sample", "Estimate of {} for the sample that the step began with", eq.outputs),
        ("std", "One-sigma error bar of {}_hat", ()),
        ("lagged", "Estimate of {} for the time lag before that sample", eq.outputs),
        ("lagged_std", "One-sigma error bar of {}_lagged", ()),
    ):
        outputs += [
            _output(eq, f"{d}_{suffix}", d, text.format(d), depends_on, bound, 0.0 if suffix.endswith("std") else None)
            for d, bound in zip(eq.disturbances, eq.disturbance_bound, strict=True)
        ]
    outputs += [
        _output(eq, f"{y}_residual", y, f"Sample of {y} minus its estimate, when the step began", (y,))
        for y in eq.outputs
    ]
    outputs += [
        _output(
            eq,
            f"{y}_residual_std",
            y,
            f"Standard deviation that {y}_residual is expected to have; 0 with method 1, which does not say",
            minimum=0.0,
        )
        for y in eq.outputs
    ]
    outputs.append(
        Variable(
            name="valid",
            causality="output",
            type="Boolean",
            description="False while no output has been used for longer than the slowest sensor's interval, or while "
            "the estimate is known to be lost"
            + (f", or {eq.disturbances[0]} because its direction vanishes" if eq.channel else ""),
            depends_on=eq.outputs,
        )
    )
    outputs.append(
        Variable(
            name="consistency",
            causality="output",
            description="Moving average of the squared residuals over their expectation; 1 where all that was told is "
            "true; 0 with method 1, which does not say",
            minimum=0.0,
        )
    )
    starts = [
        parameter(f"{name}_hat_start", value, f"Start value of the estimate of {name}", unit=_unit(eq, name))
        for name, value in zip(eq.states, eq.xhat0, strict=True)
    ]
    starts += [
        parameter(
            f"{name}_hat_start_std",
            value,
            f"Standard deviation of {name}_hat_start",
            unit=_unit(eq, name),
            positive=True,
        )
        for name, value in zip(eq.states, eq.xhat0_std, strict=True)
    ]
    return (*inputs, *outputs, *_model_parameters(eq), *starts, *_tuning(eq))


def _tuning(eq: Equations) -> list[Variable]:
    o = eq.observer
    bounds, rates, nominals = (for_each_disturbance(name, eq.disturbances) for name in _PER_DISTURBANCE)
    return [
        parameter(
            "method",
            o.method,
            "1: the paper's observer, eqs. 22-24, integrated inside the step; 2: sampled-data design",
            enumeration=METHOD,
        ),
        parameter(
            "disturbance_order",
            o.disturbance_order,
            "Method 2: r, the number of derivatives of the disturbance that the observer carries",
            type="Integer",
            minimum=0,
            maximum=3,
        ),
        *_own_orders(eq),
        *(
            parameter(f"{y}_{suffix}", value, text.format(y), unit=_unit(eq, y) if unit is None else unit, minimum=0.0)
            for suffix, values, text, unit in (
                (
                    "noise_std",
                    eq.noise_std,
                    "Standard deviation of the noise in a sample of {}; 0: only rounding",
                    None,
                ),
                ("delay", eq.delay, "Method 2: age of a sample of {} when it arrives", "s"),
                ("bias_std", eq.bias_std, "Method 2: standard deviation of a constant offset of {}; 0: none", None),
            )
            for y, value in zip(eq.outputs, values, strict=True)
        ),
        *(
            parameter(
                f"{name}_std",
                value,
                f"Method 2: one-sigma uncertainty of {name}, which widens the error bars; 0: known",
                unit=_unit(eq, name),
                minimum=0.0,
            )
            for name, value in zip(eq.parameters, eq.parameter_std, strict=True)
        ),
        parameter(
            "adapt_noise",
            o.adapt_noise,
            "Method 2: whether the noise of each output, told by <output>_noise_std, follows the residuals",
            type="Boolean",
        ),
        parameter(
            "estimate_parameters",
            o.estimate_parameters,
            "Method 2: whether the parameters with a <parameter>_std above 0 are estimated too",
            type="Boolean",
        ),
        parameter(
            "lag",
            o.lag,
            "Method 2: how long before the sample <disturbance>_lagged is; 0: at the sample",
            unit="s",
            minimum=0.0,
        ),
        *(
            parameter(bounds[d], value, f"Bound of |{d} - nominal|", unit=_unit(eq, d), positive=True)
            for d, value in zip(eq.disturbances, eq.disturbance_bound, strict=True)
        ),
        *(
            parameter(
                rates[d],
                value,
                f"Bound of the r-th derivative of {d} (of the first, for r = 0), per s^r; 0: pi_end sets the pace",
                minimum=0.0,
            )
            for d, value in zip(eq.disturbances, eq.disturbance_rate, strict=True)
        ),
        *(
            parameter(
                nominals[d],
                value,
                f"Value about which {d} is small; disturbance_bound is that of the difference",
                unit=_unit(eq, d),
            )
            for d, value in zip(eq.disturbances, eq.disturbance_nominal, strict=True)
        ),
        parameter(
            "alpha",
            o.alpha,
            "Prescribed stability; below the distance of the transmission zeros from the imaginary axis",
            unit="1/s",
            positive=True,
        ),
        parameter("pi_start", o.pi_start, "Method 1: pi of the Riccati equation at the start", positive=True),
        parameter("pi_end", o.pi_end, "Design parameter pi; of method 1 after the ramp", positive=True),
        parameter(
            "pi_ramp_time",
            o.pi_ramp_time,
            "Method 1: time in which pi rises geometrically to pi_end; 0 starts there and peaks",
            unit="s",
            minimum=0.0,
        ),
    ]


def _own_orders(eq: Equations) -> list[Variable]:
    """Return the orders of several disturbances, of which one may jump or wander while another one is smooth."""
    if len(eq.disturbances) == 1:
        return []
    return [
        parameter(
            own,
            0,
            f"Method 2: r of {d} where it is lower than disturbance_order, for which its disturbance_rate is told; "
            "0: the same",
            type="Integer",
            minimum=0,
            maximum=3,
        )
        for d, own in for_each_disturbance(OWN_ORDER, eq.disturbances).items()
    ]


def _generator(eq: Equations, name: str) -> list[Variable]:
    prefix, signal = for_each_disturbance("disturbance", eq.disturbances)[name], eq.disturbance
    return [
        parameter(
            f"{prefix}.kind",
            KINDS[signal.kind],
            f"Signal that the built-in generator adds to {name}",
            enumeration=DISTURBANCE_KIND,
        ),
        parameter(
            f"{prefix}.amplitude", signal.amplitude, "Amplitude; of a ramp the rise per second", unit=_unit(eq, name)
        ),
        parameter(
            f"{prefix}.frequency",
            signal.frequency,
            "Frequency of the sine; end frequency of the chirp",
            unit="Hz",
            minimum=0.0,
        ),
        parameter(
            f"{prefix}.start_time", signal.start_time, "Time at which ramp, sine, step or chirp begins", unit="s"
        ),
    ]


def _model_parameters(eq: Equations) -> list[Variable]:
    return [
        parameter(name, value, eq.descriptions.get(name, name.replace("_", " ")), unit=_unit(eq, name))
        for name, value in eq.parameters.items()
    ]


def _output(
    eq: Equations,
    name: str,
    of: str,
    description: str,
    depends_on: tuple[str, ...] = (),
    nominal: float | None = None,
    minimum: float | None = None,
) -> Variable:
    return Variable(
        name=name,
        causality="output",
        description=description,
        unit=_unit(eq, of),
        minimum=minimum,
        depends_on=depends_on,
        nominal=nominal,
    )


def _signal(
    eq: Equations,
    name: str,
    causality: str,
    start: float | None,
    role: str,
    *,
    sampled: bool = False,
    depends_on: tuple[str, ...] = (),
) -> Variable:
    text = eq.descriptions.get(name, name.replace("_", " "))
    return Variable(
        name=name,
        causality=causality,
        description=f"{role}: {text}",
        unit=_unit(eq, name),
        start=start,
        sampled=sampled,
        depends_on=depends_on,
    )


def _unit(eq: Equations, name: str) -> str:
    return eq.units.get(name, "")
