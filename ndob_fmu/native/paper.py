"""Method 1 in C: the printed functions that it needs, the translated observer, and `component/paper.c` around it."""

from __future__ import annotations

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.emit_c import emit_c
from ndob_fmu.codegen.print_c import RUNTIME
from ndob_fmu.model.model import Model
from ndob_fmu.native.runtime_code import part, runtime_texts
from ndob_fmu.native.thunks import matrices_thunk, thunk
from ndob_fmu.native.variable_table import number, quoted
from ndob_fmu.runtime.equations import Equations

# What a component of both methods has to translate, copy and print besides that of method 2.
TRANSLATED = {
    "ndob_fmu.runtime.step.paper_observer": (
        "paper_observer",
        "PaperObserver.init",
        "PaperObserver.possible",
        "PaperObserver.estimate",
        "PaperObserver.step",
    ),
    "ndob_fmu.runtime.design.schedule": ("PiSchedule.__post_init__",),
    "ndob_fmu.runtime.numerics.integrate": ("largest", "next_substep"),
}
COPIED = ("PaperObserver",)
PRINTED = ("nonlinearity", "matrices")


def paper_observer_text(model: Model) -> list[str]:
    """Return the C texts of method 1 for a model in the paper's form, one to come behind the other.

    Raises ModelError for an expression that has no C form.
    """
    eq = compile_model(model)
    own = [RUNTIME, emit_c(model, PRINTED), *paper_thunks(model, eq), _equations_text(eq)]
    around = [part("faults.c"), part("equations.c"), *own, part("estimate.c"), part("paper.c")]
    return [*runtime_texts(TRANSLATED, copied=COPIED), *around]


def paper_thunks(model: Model, eq: Equations) -> list[str]:
    """Return the thunks of the functions that method 1 calls."""
    assert eq.matrices is not None
    n, m, p, q = len(eq.states), len(eq.inputs), len(eq.outputs), len(eq.disturbances)
    q_f = len(eq.matrices(model.parameter_values())[3][0])
    shapes = [(n, n), (n, m), (p, n), (n, q_f), (n, q)]
    return [thunk("nonlinearity", 3, q_f), matrices_thunk(shapes)]


def _equations_text(eq: Equations) -> str:
    """Return `set_equations`, which fills what method 1 reads of the plant."""
    lines = [
        "memset(equations, 0, sizeof *equations);",
        f"equations->name = {quoted(eq.name)};",
        f"equations->states.n = {len(eq.states)};",
        f"equations->inputs.n = {len(eq.inputs)};",
        f"equations->outputs.n = {len(eq.outputs)};",
        f"equations->disturbances.n = {len(eq.disturbances)};",
        f"equations->lipschitz = {number(eq.lipschitz)};",
        f"equations->matched = {'true' if eq.matched else 'false'};",
        "equations->nonlinearity.call = call_nonlinearity;",
        "equations->matrices.some = true;",
        "equations->matrices.value.call = call_matrices;",
    ]
    body = "\n".join(f"    {line}" for line in lines)
    return f"static void set_equations(Equations *equations) {{\n{body}\n}}\n"
