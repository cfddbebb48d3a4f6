"""The observer in C: the printed functions of the model, the translated design and steps, and what keeps their results.

Method 2 so far. `component/sampled.c` says how its functions are called.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.emit_c import emit_c
from ndob_fmu.codegen.print_c import RUNTIME
from ndob_fmu.model.model import Model
from ndob_fmu.native.continued import continued_text
from ndob_fmu.native.thunks import converged_step_thunk, matrices_thunk, thunk
from ndob_fmu.native.translate.print_c import translate
from ndob_fmu.native.variable_table import number, quoted
from ndob_fmu.runtime.equations import Equations

_HERE = Path(__file__).parent
_STEP, _DESIGN = "ndob_fmu.runtime.step", "ndob_fmu.runtime.design"
_TRANSLATED = {
    f"{_STEP}.sampled_step": (
        "start_state",
        "is_possible_state",
        "estimate_before_a_step",
        "step_to_tune_for",
        "step_by_definition",
        "step_converged",
    ),
    f"{_STEP}.preparation": ("prepared",),
    f"{_STEP}.tuned": ("tune",),
    f"{_STEP}.converged_step": ("converged_step",),
    f"{_DESIGN}.step_designs": ("StepDesigns.at",),
    "ndob_fmu.runtime.numerics.integrate": ("largest", "next_substep"),
}
_COPIED = ("PreparedObserver", "Tuned", "StepDesign", "ConvergedStep", "SampledObserverState")
_PRINTED = ("derivatives", "output", "linearisation", "input_slopes", "sensitivity", "observer_constants")


def sampled_observer_text(model: Model) -> list[str]:
    """Return the C texts of method 2 for a model, one to come behind the other.

    Raises ModelError for an expression that has no C form.
    """
    eq = compile_model(model)
    only = [f"{module}.{name}" for module, names in _TRANSLATED.items() for name in names]
    translation = translate(
        list(_TRANSLATED), "translated", only=only, copied=_COPIED, stored=("SampledObserverState",)
    )
    if translation.refused:
        raise ValueError(f"functions that do not translate: {next(iter(translation.refused.values()))}")
    arrays = [(_HERE / "c" / name).read_text("utf-8") for name in ("nd.h", "nd.c", "nd_linear.c")]
    component = [(_HERE / "component" / name).read_text("utf-8") for name in ("faults.c", "equations.c", "sampled.c")]
    own = [RUNTIME, *_printed(model, eq), equations_text(eq)]
    return [*arrays, translation.header, translation.source, *component[:2], *own, component[2]]


def _printed(model: Model, eq: Equations) -> list[str]:
    """Return the printed functions and their thunks."""
    n, m, p, q = len(eq.states), len(eq.inputs), len(eq.outputs), len(eq.disturbances)
    parameters = model.parameter_values()
    constants = len(eq.steps.observer_constants(parameters))
    names = [*_PRINTED, "observer_step", *(("matrices",) if eq.matrices else ())]
    text = emit_c(model, names)
    counts = {
        "derivatives": (4, n),
        "output": (3, p),
        "linearisation": (4, (n + p) * (n + q)),
        "input_slopes": (4, (n + p) * m),
        "sensitivity": (4, (n + p) * len(parameters)),
        "observer_constants": (1, constants),
    }
    thunks = [thunk(name, arity, count) for name, (arity, count) in counts.items()]
    if eq.matrices:
        q_f = len(eq.matrices(parameters)[3][0])
        thunks.append(matrices_thunk([(n, n), (n, m), (p, n), (n, q_f), (n, q)]))
    head = next(line for line in text.splitlines() if line.startswith("static int observer_step("))
    outputs = n + 5 * q + 2 * p + 2
    fields = re.findall(r"_gain_(\w+)", head)
    thunks.append(converged_step_thunk(fields, [n + 3 * q, n + 3 * q, q, p, m, p, p, outputs]))
    return [text, *thunks, continued_text(eq)]


def equations_text(eq: Equations) -> str:
    """Return `set_equations`, which fills the structure that the translated functions know the plant by."""
    functions = ["derivatives", "output", "linearisation", "input_slopes", "sensitivity"]
    lines = [
        "memset(equations, 0, sizeof *equations);",
        f"equations->name = {quoted(eq.name)};",
        *_names("states", eq.states),
        *_names("inputs", eq.inputs),
        *_names("outputs", eq.outputs),
        *_names("disturbances", eq.disturbances),
        *_vector("disturbance_nominal", eq.disturbance_nominal),
        *_vector("f_states", eq.f_states),
        f"equations->lipschitz = {number(eq.lipschitz)};",
        f"equations->matched = {'true' if eq.matched else 'false'};",
        f"equations->experiment.step_size = {number(eq.experiment.step_size)};",
        f"equations->experiment.stop_time = {number(eq.experiment.stop_time)};",
        *_ranges(eq),
        *(f"equations->{name}.call = {'continued' if eq.ranges else 'call'}_{name};" for name in functions),
        "equations->steps.observer_constants.call = call_observer_constants;",
        "equations->steps.observer_step.call = call_observer_step;",
    ]
    if eq.matrices:
        lines += ["equations->matrices.some = true;", "equations->matrices.value.call = call_matrices;"]
    body = "\n".join(f"    {line}" for line in lines)
    return f"static void set_equations(Equations *equations) {{\n{body}\n}}\n"


def _names(field: str, names: Sequence[str]) -> list[str]:
    if not names:
        return []
    listed = ", ".join(map(quoted, names))
    return [
        f"static const char *const {field}[] = {{{listed}}};",
        f"equations->{field}.n = {len(names)}, equations->{field}.p = {field};",
    ]


def _vector(field: str, values: Sequence[float]) -> list[str]:
    listed = ", ".join(number(float(value)) for value in values) or "0.0"
    return [
        f"static const double {field}[] = {{{listed}}};",
        f"equations->{field} = nd_view_of({len(values)}, {field});",
    ]


def _ranges(eq: Equations) -> list[str]:
    if not eq.ranges:
        return []
    names = ", ".join(map(quoted, eq.ranges))
    pairs = ", ".join(f"{{{number(low)}, {number(high)}}}" for low, high in eq.ranges.values())
    return [
        f"static const char *const ranged[] = {{{names}}};",
        f"static p2_double_double ranges[] = {{{pairs}}};",
        f"equations->ranges.n = {len(eq.ranges)}, equations->ranges.names = ranged, equations->ranges.p = ranges;",
    ]
