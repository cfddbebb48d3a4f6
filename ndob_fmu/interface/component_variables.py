"""The variables of the component FMUs: disturbance source, encoder, torsion spring and controller."""

from __future__ import annotations

from collections.abc import Mapping

from ndob_fmu.interface.model_variables import Variable
from ndob_fmu.runtime.blocks.controller import Feedback
from ndob_fmu.runtime.blocks.disturbance_source import INTERPOLATIONS, SOURCE_KINDS
from ndob_fmu.runtime.blocks.sampled_measurement import MISSING
from ndob_fmu.runtime.equations import Equations, Experiment

DESCRIPTIONS = {
    "source": "Disturbance as a function of time: signals, band-limited noise, or a profile from a file",
    "encoder": "Encoder: a sampled, quantised, delayed and sometimes lost measurement of an angle",
    "spring": "Torsion spring: pulls two angles together",
    "controller": "State feedback on the observer's estimates, with compensation of the estimated disturbance",
}
EXPERIMENT = Experiment(stop_time=10.0, step_size=1e-3)


def source_variables() -> tuple[Variable, ...]:
    """Return the variables of `DisturbanceSource`. The output has no unit, so that it fits any disturbance."""
    return (
        Variable("disturbance", "output", "Disturbance at the end of the step, in the unit of what it drives"),
        _parameter("disturbance.kind", 1, "Signal", type_="Enumeration", items=SOURCE_KINDS),
        _parameter(
            "disturbance.amplitude",
            1.0,
            "Amplitude; of a ramp the rise per second, of noise the standard deviation, of a profile a factor",
        ),
        _parameter(
            "disturbance.frequency",
            1.0,
            "Frequency of the sine; end frequency of the chirp; upper end of the noise's band",
            unit="Hz",
            minimum=0.0,
        ),
        _parameter("disturbance.start_time", 0.0, "Time before which all but the constant are 0", unit="s"),
        _parameter("disturbance.seed", 0, "Seed of the noise", type_="Integer", minimum=0),
        Variable(
            "disturbance.profile",
            "parameter",
            "Path of a CSV file whose first two columns are time since start_time in s, and value",
            type="String",
            start="",
        ),
        _parameter(
            "disturbance.interpolation",
            1,
            "Between two rows of the profile",
            type_="Enumeration",
            items=INTERPOLATIONS,
        ),
    )


def encoder_variables() -> tuple[Variable, ...]:
    """Return the variables of `Encoder`."""
    return (
        Variable("angle", "input", "Angle that is sampled", start=0.0, unit="rad", sampled=True),
        Variable("measured_angle", "output", "What is shown", unit="rad", depends_on=("angle",), sampled=True),
        Variable(
            "new_sample",
            "output",
            "True where measured_angle is a sample that was not shown before",
            type="Boolean",
            depends_on=("angle",),
        ),
        _parameter(
            "counts_per_revolution", 4096, "Resolution; 4096 is 12 bits, 0 none at all", type_="Integer", minimum=0
        ),
        _parameter("noise_std", 0.0, "Standard deviation of the noise before rounding", unit="rad", minimum=0.0),
        _parameter("bias", 0.0, "Added to the angle before rounding", unit="rad"),
        _parameter("seed", 0, "Seed of noise and dropouts; encoders with the same one err alike", "Integer", minimum=0),
        _parameter("sample_time", 0.0, "Time between samples; 0: one for each step", unit="s", minimum=0.0),
        _parameter("delay", 0.0, "Time after which a sample is shown", unit="s", minimum=0.0),
        _parameter("dropout_probability", 0.0, "Probability that a sample is lost", minimum=0.0, maximum=1.0),
        _parameter("dropped_sample", 2, "What is shown for a lost sample", "Enumeration", items=MISSING),
        _parameter("between_samples", 1, "What is shown where no sample is due", "Enumeration", items=MISSING),
    )


def spring_variables() -> tuple[Variable, ...]:
    """Return the variables of `TorsionSpring`."""
    angles = ("angle_a", "angle_b")
    return (
        *(Variable(name, "input", "Angle of one end", start=0.0, unit="rad") for name in angles),
        *(
            Variable(f"torque_{end}", "output", f"Torque on the end of angle_{end}", unit="N.m", depends_on=angles)
            for end in ("a", "b")
        ),
        _parameter("stiffness", 1.0, "Stiffness", unit="N.m/rad", minimum=0.0),
    )


def controller_variables(eq: Equations, feedback: Feedback) -> tuple[Variable, ...]:
    """Return the variables of `<Name>Controller`: inputs as the observer's outputs, outputs as the plant's inputs."""
    unit = eq.units.get
    references = tuple(f"{name}_reference" for name in feedback.regulated)
    estimates = tuple(f"{name}_hat" for name in (*eq.states, *eq.disturbances))
    return (
        *(
            Variable(name, "input", f"Reference of {of}", start=0.0, unit=unit(of, ""), sampled=True)
            for name, of in zip(references, feedback.regulated, strict=True)
        ),
        *(
            Variable(f"{name}_hat", "input", f"Estimate of {name}", start=0.0, unit=unit(name, ""), sampled=True)
            for name in (*eq.states, *eq.disturbances)
        ),
        *(
            Variable(u, "output", f"Command: {u}", unit=unit(u, ""), depends_on=(*references, *estimates), sampled=True)
            for u in eq.inputs
        ),
        Variable(
            "saturated",
            "output",
            "True where a command is at its limit",
            type="Boolean",
            depends_on=(*references, *estimates),
        ),
        *(
            _parameter(
                name, value, eq.descriptions.get(name, name.replace("_", " ")) + ", as assumed", unit=unit(name, "")
            )
            for name, value in eq.parameters.items()
        ),
        *(
            _parameter(name, value, f"Gain from {x} to {u}")
            for (u, x), (name, value) in zip(
                ((u, x) for u in eq.inputs for x in eq.states), gains(eq, feedback).items(), strict=True
            )
        ),
        *(
            _parameter(f"{u}_limit", 0.0, f"Largest magnitude of {u}; 0: no limit", unit=unit(u, ""), minimum=0.0)
            for u in eq.inputs
        ),
        Variable(
            "compensation",
            "parameter",
            "Whether the estimated disturbance is compensated",
            type="Boolean",
            start=True,
        ),
    )


def gains(eq: Equations, feedback: Feedback) -> dict[str, float]:
    """Return K by the names of its parameters, row after row; the input is named where there are several."""
    return {
        f"gain.{x}" if len(eq.inputs) == 1 else f"gain.{u}.{x}": value
        for u, row in zip(eq.inputs, feedback.gain, strict=True)
        for x, value in zip(eq.states, row, strict=True)
    }


def _parameter(
    name: str,
    start: float,
    description: str,
    type_: str = "Real",
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    items: Mapping[str, int] | None = None,
) -> Variable:
    return Variable(name, "parameter", description, type_, start, unit, minimum=minimum, maximum=maximum, items=items)
