"""The variables that all sampling devices have."""

from __future__ import annotations

from ndob_fmu.interface.variables import Enumeration, Variable, parameter
from ndob_fmu.runtime.blocks.sampled_measurement import MISSING

_MISSING = Enumeration(
    "MissingSample", MISSING, {"held": "the value before", "not_a_number": "NaN, which the observer skips"}
)


def sampling_signals(measured: str, what: str, unit: str = "") -> tuple[Variable, ...]:
    """Return the input `measured`, and as outputs its sample and whether that is a new one.

    what: the measured quantity, in words
    """
    return (
        Variable(measured, "input", f"{what} that is sampled", start=0.0, unit=unit, sampled=True),
        Variable(f"measured_{measured}", "output", "What is shown", unit=unit, depends_on=(measured,), sampled=True),
        Variable(
            "new_sample",
            "output",
            f"True where measured_{measured} is a sample that was not shown before",
            type="Boolean",
            depends_on=(measured,),
        ),
    )


def sampling_parameters(device: str, quantity: str, unit: str = "") -> tuple[Variable, ...]:
    """Return the parameters of noise, bias, times and missing samples.

    device: what the FMU is, in the plural; quantity: what it measures, in words
    """
    return (
        parameter("noise_std", 0.0, "Standard deviation of the noise before rounding", unit=unit, minimum=0.0),
        parameter("bias", 0.0, f"Added to the {quantity} before rounding", unit=unit),
        parameter(
            "seed", 0, f"Seed of noise and dropouts; {device} with the same one err alike", type="Integer", minimum=0
        ),
        parameter("sample_time", 0.0, "Time between samples; 0: one for each step", unit="s", minimum=0.0),
        parameter("delay", 0.0, "Time after which a sample is shown", unit="s", minimum=0.0),
        parameter("dropout_probability", 0.0, "Probability that a sample is lost", minimum=0.0, maximum=1.0),
        parameter("dropped_sample", 2, "What is shown for a lost sample", enumeration=_MISSING),
        parameter("between_samples", 1, "What is shown where no sample is due", enumeration=_MISSING),
    )
