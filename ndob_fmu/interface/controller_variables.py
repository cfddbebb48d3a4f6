"""The variables of `<Name>Controller`."""

from __future__ import annotations

from ndob_fmu.interface.variables import Variable, parameter
from ndob_fmu.runtime.blocks.controller import Feedback
from ndob_fmu.runtime.equations import Equations


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
            parameter(
                name, value, eq.descriptions.get(name, name.replace("_", " ")) + ", as assumed", unit=unit(name, "")
            )
            for name, value in eq.parameters.items()
        ),
        *(
            parameter(name, value, f"Gain from {x} to {u}")
            for (u, x), (name, value) in zip(
                ((u, x) for u in eq.inputs for x in eq.states), gains(eq, feedback).items(), strict=True
            )
        ),
        *(
            parameter(f"{u}_limit", 0.0, f"Largest magnitude of {u}; 0: no limit", unit=unit(u, ""), minimum=0.0)
            for u in eq.inputs
        ),
        parameter("compensation", True, "Whether the estimated disturbance is compensated", type="Boolean"),
    )


def gains(eq: Equations, feedback: Feedback) -> dict[str, float]:
    """Return K by the names of its parameters, row after row; the input is named where there are several."""
    return {
        f"gain.{x}" if len(eq.inputs) == 1 else f"gain.{u}.{x}": value
        for u, row in zip(eq.inputs, feedback.gain, strict=True)
        for x, value in zip(eq.states, row, strict=True)
    }
