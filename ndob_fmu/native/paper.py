"""Method 1 in C: the printed functions that it needs, the translated observer, and `component/paper.c` around it."""

from __future__ import annotations

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from ndob_fmu.native.equations import USED_BY_PRINTED, channel_size, equations_text, function_texts
from ndob_fmu.native.runtime_code import part, runtime_texts

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
    **USED_BY_PRINTED,
}
COPIED = ("PaperObserver",)
PRINTED = ("nonlinearity", "matrices")


def paper_observer_text(model: Model) -> list[str]:
    """Return the C texts of method 1 for a model in the paper's form, one to come behind the other.

    Raises ModelError for an expression that has no C form.
    """
    eq = compile_model(model)
    own = function_texts(model, eq, PRINTED)
    filled = equations_text(eq, {name: f"call_{name}" for name in PRINTED})
    around = [channel_size(eq), part("faults.c"), *own, filled, part("estimate.c"), part("paper.c")]
    return [*runtime_texts(TRANSLATED, copied=COPIED), *around]
