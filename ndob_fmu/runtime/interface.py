"""The variables of the two FMUs, declared once: the slaves register them, the model description completes them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ndob_fmu.runtime.disturbance import KINDS
from ndob_fmu.runtime.equations import Equations

METHODS = {"paper": 1}
_OBSERVER_PARAMETERS = ("method", "alpha", "pi_start", "pi_end", "pi_ramp_time")
# Names of the contract that later methods use; a model that takes one now could not be built then.
_RESERVED = (*_OBSERVER_PARAMETERS, "disturbance_order", "noise_std", "disturbance_bound", "disturbance_rate")


@dataclass(frozen=True)
class Variable:
    """One FMI variable.

    `depends_on` names the inputs that an output shows already in initialization mode; once stepping, outputs are
    those of the end of the last step, whatever the inputs become afterwards.
    """

    name: str
    causality: str
    description: str
    type: str = "Real"
    start: float | int | bool | None = None
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    items: Mapping[str, int] | None = None
    depends_on: tuple[str, ...] = ()

    @property
    def variability(self) -> str:
        """FMI variability: parameters are fixed, numbers that flow are continuous, flags discrete."""
        if self.causality == "parameter":
            return "fixed"
        return "continuous" if self.type == "Real" else "discrete"


def reserved_names(states: Iterable[str], outputs: Iterable[str], disturbances: Iterable[str]) -> set[str]:
    """Return the variable names that the FMUs derive or use themselves, so that a model cannot take them."""
    derived = {f"{state}{suffix}" for state in states for suffix in ("_hat", "_start", "_hat_start")}
    derived |= {f"{output}_residual" for output in outputs}
    derived |= {f"{d}{suffix}" for d in disturbances for suffix in ("_hat", "_at_sample", "_std", "_total")}
    return derived | set(_RESERVED) | {"time", "valid", "disturbance"}


def generator_prefixes(disturbances: tuple[str, ...]) -> dict[str, str]:
    """Return the prefix of each disturbance's generator parameters: `disturbance` if it is the only one."""
    if len(disturbances) == 1:
        return {disturbances[0]: "disturbance"}
    return {name: f"disturbance.{name}" for name in disturbances}


def plant_variables(eq: Equations) -> tuple[Variable, ...]:
    """Return the variables of `<Name>Plant`."""
    inputs = [_signal(eq, name, "input", 0.0, "Input") for name in eq.inputs]
    inputs += [_signal(eq, name, "input", 0.0, "Disturbance, added to the generator's") for name in eq.disturbances]
    outputs = [_signal(eq, name, "output", None, "Measured output") for name in eq.outputs]
    outputs += [_signal(eq, name, "output", None, "State") for name in eq.states if name not in eq.outputs]
    totals = [
        Variable(
            name=f"{name}_total",
            causality="output",
            description=f"Generator plus input {name}, at the end of the step",
            unit=eq.units.get(name, ""),
            depends_on=(name,),
        )
        for name in eq.disturbances
    ]
    starts = [
        Variable(
            name=f"{name}_start",
            causality="parameter",
            description=f"Start value of {name}",
            unit=eq.units.get(name, ""),
            start=value,
        )
        for name, value in zip(eq.states, eq.x0, strict=True)
    ]
    generators = [variable for name in eq.disturbances for variable in _generator(eq, name)]
    return (*inputs, *outputs, *totals, *_model_parameters(eq), *starts, *generators)


def observer_variables(eq: Equations) -> tuple[Variable, ...]:
    """Return the variables of `<Name>Observer`, its outputs in the order of `Estimate`'s fields."""
    inputs = [_signal(eq, name, "input", 0.0, "Input of the plant") for name in eq.inputs]
    inputs += [_signal(eq, name, "input", 0.0, "Measured output of the plant") for name in eq.outputs]

    def estimate(name: str, of: str, text: str, depends: tuple[str, ...] = ()) -> Variable:
        unit = eq.units.get(of, "")
        return Variable(name=name, causality="output", description=text, unit=unit, depends_on=depends)

    outputs = [estimate(f"{s}_hat", s, f"Estimate of {s} for the end of the step") for s in eq.states]
    outputs += [
        estimate(f"{d}_hat", d, f"Estimate of {d} for the end of the step", eq.outputs) for d in eq.disturbances
    ]
    outputs += [
        estimate(f"{d}_at_sample", d, f"Estimate of {d} for the sample that the step began with", eq.outputs)
        for d in eq.disturbances
    ]
    outputs += [
        estimate(f"{y}_residual", y, f"Sample of {y} minus its estimate, when the step began", (y,)) for y in eq.outputs
    ]
    outputs.append(
        Variable(
            name="valid",
            causality="output",
            type="Boolean",
            description="False while the estimate coasts because a sample was not a finite number",
            depends_on=eq.outputs,
        )
    )
    starts = [
        Variable(
            name=f"{name}_hat_start",
            causality="parameter",
            description=f"Start value of the estimate of {name}",
            unit=eq.units.get(name, ""),
            start=value,
        )
        for name, value in zip(eq.states, eq.xhat0, strict=True)
    ]
    return (*inputs, *outputs, *_model_parameters(eq), *starts, *_tuning(eq))


def _tuning(eq: Equations) -> list[Variable]:
    o = eq.observer
    return [
        Variable(
            name="method",
            causality="parameter",
            type="Enumeration",
            items=METHODS,
            start=METHODS["paper"],
            description="How the estimate is made: 1 = the paper's observer, eqs. 22-24, integrated inside the step",
        ),
        Variable(
            name="alpha",
            causality="parameter",
            start=o.alpha,
            unit="1/s",
            minimum=0.0,
            description="Prescribed stability; below the distance of the transmission zeros from the imaginary axis",
        ),
        Variable(
            name="pi_start",
            causality="parameter",
            start=o.pi_start,
            minimum=0.0,
            nominal=o.pi_start,
            description="Design parameter pi of the Riccati equation at the start",
        ),
        Variable(
            name="pi_end",
            causality="parameter",
            start=o.pi_end,
            minimum=0.0,
            nominal=o.pi_end,
            description="Design parameter pi of the Riccati equation after the ramp",
        ),
        Variable(
            name="pi_ramp_time",
            causality="parameter",
            start=o.pi_ramp_time,
            unit="s",
            minimum=0.0,
            description="Time in which pi rises geometrically from pi_start to pi_end; 0 starts at pi_end and peaks",
        ),
    ]


def _generator(eq: Equations, name: str) -> list[Variable]:
    prefix, signal, unit = generator_prefixes(eq.disturbances)[name], eq.disturbance, eq.units.get(name, "")
    return [
        Variable(
            name=f"{prefix}.kind",
            causality="parameter",
            type="Enumeration",
            items=KINDS,
            start=KINDS[signal.kind],
            description=f"Signal that the built-in generator adds to {name}",
        ),
        Variable(
            name=f"{prefix}.amplitude",
            causality="parameter",
            start=signal.amplitude,
            unit=unit,
            description="Amplitude; of a ramp the rise per second",
        ),
        Variable(
            name=f"{prefix}.frequency",
            causality="parameter",
            start=signal.frequency,
            unit="Hz",
            minimum=0.0,
            description="Frequency of the sine; end frequency of the chirp",
        ),
        Variable(
            name=f"{prefix}.start_time",
            causality="parameter",
            start=signal.start_time,
            unit="s",
            description="Time at which ramp, sine, step or chirp begins",
        ),
    ]


def _signal(eq: Equations, name: str, causality: str, start: float | None, role: str) -> Variable:
    text = eq.descriptions.get(name, name.replace("_", " "))
    return Variable(
        name=name, causality=causality, description=f"{role}: {text}", unit=eq.units.get(name, ""), start=start
    )


def _model_parameters(eq: Equations) -> list[Variable]:
    return [
        Variable(
            name=name,
            causality="parameter",
            description=eq.descriptions.get(name, name.replace("_", " ")),
            unit=eq.units.get(name, ""),
            start=value,
        )
        for name, value in eq.parameters.items()
    ]
