"""`<Name>Plant` in C: the printed functions of the model, the translated integrators, and the component around them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.emit_c import emit_c
from ndob_fmu.codegen.print_c import RUNTIME
from ndob_fmu.model.model import Model
from ndob_fmu.native.join import joined
from ndob_fmu.native.sources import ComponentCode
from ndob_fmu.native.thunks import thunk, trial_thunk
from ndob_fmu.native.translate.print_c import translate
from ndob_fmu.native.variable_table import number

_HERE = Path(__file__).parent
_RUNTIME = "ndob_fmu.runtime"
_PRINTED = ("derivatives", "output", "linearisation", "plant_constants", "plant_trial")
_TRANSLATED = {
    f"{_RUNTIME}.blocks.plant": ("Plant.step", "Plant.possible", "Plant.disturbance"),
    f"{_RUNTIME}.numerics.integrate": ("largest", "next_substep"),
    f"{_RUNTIME}.times": ("same_time",),
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
        "MEMORY": _memory(n, q, constants),
    }
    thunks = [
        thunk("derivatives", 4, n),
        thunk("output", 3, len(eq.outputs)),
        thunk("linearisation", 4, (n + len(eq.outputs)) * (n + q)),
        thunk("plant_constants", 1, constants),
        trial_thunk(n),
    ]
    own = "\n".join(
        [
            *(f"#define {name} {value}" for name, value in sizes.items()),
            f"static const int hidden[] = {{{', '.join(map(str, hidden)) or '0'}}};",
            f"static const double nominal[] = {{{', '.join(map(number, eq.disturbance_nominal))}}};\n",
        ]
    )
    text = [_part("equations.c"), RUNTIME, emit_c(model, _PRINTED), *thunks, _part("call.c"), own, _part("plant.c")]
    return component(_TRANSLATED, text)


def component(wanted: Mapping[str, Sequence[str]], own: Sequence[str]) -> ComponentCode:
    """Return a component made of its own texts, of functions of the runtime, by module, and of the arrays."""
    only = [f"{module}.{name}" for module, names in wanted.items() for name in names]
    translation = translate(list(wanted), "translated", only=only)
    missing = [f"{name}: {why}" for name, why in translation.refused.items() if name in only]
    if missing:
        raise ValueError(f"functions that do not translate: {missing[0]}")
    arrays = [(_HERE / "c" / name).read_text("utf-8") for name in ("nd.h", "nd.c", "nd_linear.c")]
    return ComponentCode(joined([*arrays, translation.header, translation.source, *own], "start show step possible"))


def _memory(n: int, q: int, constants: int) -> int:
    """Return the bytes that a step computes in: about fifty matrices of the stiff integrator, and vectors."""
    return 16 * (4096 + 64 * (n + 1) ** 2 + 16 * (n + q + constants))


def _part(name: str) -> str:
    text = (_HERE / "component" / name).read_text("utf-8")
    return "\n".join(line for line in text.splitlines() if not line.startswith('#include "'))
