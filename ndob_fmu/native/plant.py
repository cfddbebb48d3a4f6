"""`<Name>Plant` in C: the printed functions of the model, the translated integrators, and the component around them."""

from __future__ import annotations

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from ndob_fmu.native.equations import function_texts
from ndob_fmu.native.runtime_code import component, part
from ndob_fmu.native.sources import ComponentCode
from ndob_fmu.native.thunks import trial_thunk
from ndob_fmu.native.variable_table import number

_PRINTED = ("derivatives", "output", "linearisation", "plant_constants")
_TRANSLATED = {
    "blocks.plant": ("Plant.step", "Plant.possible", "Plant.disturbance"),
    "numerics.integrate": ("largest", "next_substep"),
    "times": ("same_time",),
}


def plant_code(model: Model) -> ComponentCode:
    """Return the component of the model's plant.

    Raises ModelError for an expression that has no C form.
    """
    eq = compile_model(model)
    n, q = len(eq.states), len(eq.disturbances)
    hidden = [i for i, name in enumerate(eq.states) if name not in eq.outputs]
    constants = len(eq.steps.plant_constants(model.parameter_values()))
    sizes = {
        "STATES": n,
        "INPUTS": len(eq.inputs),
        "OUTPUTS": len(eq.outputs),
        "DISTURBANCES": q,
        "PARAMETERS": len(eq.parameters),
        "HIDDEN_STATES": len(hidden),
        "JUMPS": int(eq.surfaces is not None),
        "MEMORY": _memory(n, q, constants),
    }
    own = "\n".join(
        [
            *(f"#define {name} {value}" for name, value in sizes.items()),
            f"static const int hidden[] = {{{', '.join(map(str, hidden)) or '0'}}};",
            f"static const double nominal[] = {{{', '.join(map(number, eq.disturbance_nominal))}}};\n",
        ]
    )
    text = [
        part("faults.c"),
        part("call.c"),
        part("memory.c"),
        *function_texts(model, eq, [*_PRINTED, *(["surfaces"] if eq.surfaces else [])], ["plant_trial"]),
        trial_thunk(n),
        own,
        part("plant.c"),
    ]
    return component(_TRANSLATED, text)


def _memory(n: int, q: int, constants: int) -> int:
    """Return the bytes that a step computes in: about fifty matrices of the stiff integrator, and vectors."""
    return 16 * (4096 + 64 * (n + 1) ** 2 + 16 * (n + q + constants))
