"""`<Name>Controller` in C: the model's printed functions, the translated feedback, and the component around them."""

from __future__ import annotations

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from ndob_fmu.native.equations import equations_text, function_texts
from ndob_fmu.native.runtime_code import component, part
from ndob_fmu.native.sources import ComponentCode
from ndob_fmu.native.variable_table import quoted
from ndob_fmu.runtime.blocks.controller import Feedback

_PRINTED = ("derivatives", "linearisation", "input_slopes")
_TRANSLATED = {
    "blocks.controller": tuple(f"Controller.{name}" for name in ("start", "step", "possible", "saturates")),
    "numerics.integrate": ("largest", "next_substep"),
}


def controller_code(model: Model, feedback: Feedback) -> ComponentCode:
    """Return the component of a model's controller with this feedback.

    Raises ModelError for an expression that has no C form.
    """
    eq = compile_model(model)
    n, m, p, q = len(eq.states), len(eq.inputs), len(eq.outputs), len(eq.disturbances)
    names = [*_PRINTED, *(("matrices",) if eq.matrices else ())]
    sizes = {
        "STATES": n,
        "INPUTS": m,
        "DISTURBANCES": q,
        "PARAMETERS": len(eq.parameters),
        "MEMORY": _memory(n, m, p, q),
    }
    own = [
        *(f"#define {name} {value}" for name, value in sizes.items()),
        f"static const char *const regulated[] = {{{', '.join(map(quoted, feedback.regulated))}}};\n",
    ]
    text = [
        part("faults.c"),
        part("call.c"),
        part("memory.c"),
        *function_texts(model, eq, names),
        equations_text(eq, {name: f"call_{name}" for name in names}),
        "\n".join(own),
        part("controller.c"),
    ]
    return component(_TRANSLATED, text)


def _memory(n: int, m: int, p: int, q: int) -> int:
    """Return the bytes that a step computes in: ten matrices of an iteration of Newton's method, and vectors."""
    return 8 * (128 + 16 * (n + m + p + q) ** 2)
