"""A plant's equations in C: its printed functions, and the structure by which translated code knows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ndob_fmu.codegen.c_expressions import RUNTIME
from ndob_fmu.codegen.emit_c import emit_c
from ndob_fmu.model.model import Model
from ndob_fmu.native.runtime_code import part
from ndob_fmu.native.short_code import fast, short
from ndob_fmu.native.thunks import matrices_thunk, thunk
from ndob_fmu.native.variable_table import number, quoted
from ndob_fmu.runtime.equations import Equations

# Functions that not every plant has.
NOT_ALWAYS = ("matrices", "surfaces")
# What the printed functions call of the runtime.
USED_BY_PRINTED = {"ndob_fmu.runtime.numerics.integrate": ("largest", "next_substep")}


def function_texts(model: Model, eq: Equations, names: Sequence[str], more: Sequence[str] = ()) -> list[str]:
    """Return the C texts of the model's functions, each of `names` also as `call_<name>` for translated code.

    more: functions of a step, whose thunks the caller writes; compilers make them fast, the others short

    Raises ModelError for an expression that has no C form.
    """
    n, m, p, q = len(eq.states), len(eq.inputs), len(eq.outputs), len(eq.disturbances)
    parameters = model.parameter_values()
    G_f, k = model.vector_field.parts.G_f.cols, model.vector_field.G_d.cols
    sizes = {"nonlinearity": (3, G_f), "output": (3, p), "direction": (3, k)}
    sizes["surfaces"] = (3, len(model.vector_field.jumps_at) * (1 + n))
    for prefix, inputs in (("", q), ("lumped_", k)):
        sizes |= {
            f"{prefix}derivatives": (4, n),
            f"{prefix}linearisation": (4, (n + p) * (n + inputs)),
            f"{prefix}input_slopes": (4, (n + p) * m),
            f"{prefix}sensitivity": (4, (n + p) * len(parameters)),
        }

    def thunk_of(name: str) -> str:
        if name == "matrices":
            return matrices_thunk([(n, n), (n, m), (p, n), (n, G_f), (n, k)])
        if name.endswith("_constants"):
            return thunk(name, 1, len(getattr(eq.steps, name)(parameters)))
        return thunk(name, *sizes[name])

    of_steps, others = fast(emit_c(model, more)), short(emit_c(model, names), *map(thunk_of, names))
    return [part("equations.c"), RUNTIME, *of_steps, *others]


def equations_text(eq: Equations, functions: Mapping[str, str], name: str = "set_equations") -> str:
    """Return a function of C that fills the structure `Equations`; views of vectors lie in the memory it gets.

    functions: the fields that are functions, with their names in C
    name: of the function
    """
    lines = [
        "memset(equations, 0, sizeof *equations);",
        f"equations->name = {quoted(eq.name)};",
        *_names("states", eq.states),
        *_names("inputs", eq.inputs),
        *_names("outputs", eq.outputs),
        *_names("disturbances", eq.disturbances),
        *_vector("x0", eq.x0),
        *_vector("disturbance_nominal", eq.disturbance_nominal),
        *_vector("f_states", eq.f_states),
        f"equations->lipschitz = {number(eq.lipschitz)};",
        f"equations->matched = {'true' if eq.matched else 'false'};",
        f"equations->experiment.step_size = {number(eq.experiment.step_size)};",
        f"equations->experiment.stop_time = {number(eq.experiment.stop_time)};",
        *_ranges(eq),
        *_channel(eq),
    ]
    for field, call in functions.items():
        if field in NOT_ALWAYS:
            lines += [f"equations->{field}.some = true;", f"equations->{field}.value.call = {call};"]
        else:
            lines.append(f"equations->{field}.call = {call};")
    body = "\n".join(f"    {line}" for line in lines)
    return f"static void {name}(Equations *equations, nd_arena *memory) {{\n{body}\n}}\n"


def channel_size(eq: Equations) -> str:
    """Return C text that defines CHANNEL, the number of inputs that are lumped; 0 without a channel."""
    return f"#define CHANNEL {0 if eq.channel is None else len(eq.channel.bound)}\n"


def _names(field: str, names: Sequence[str]) -> list[str]:
    if not names:
        return []
    listed = ", ".join(map(quoted, names))
    return [
        f"static const char *const {field}[] = {{{listed}}};",
        f"equations->{field}.n = {len(names)}, equations->{field}.p = {field};",
    ]


def _vector(field: str, values: Sequence[float]) -> list[str]:
    listed, name = ", ".join(number(float(value)) for value in values) or "0.0", field.replace(".", "_")
    return [
        f"static const double {name}[] = {{{listed}}};",
        f"equations->{field} = nd_view_of(memory, {len(values)}, {name});",
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


def _channel(eq: Equations) -> list[str]:
    if eq.channel is None:
        return []
    return [
        "equations->channel.some = true;",
        *_vector("channel.value.bound", eq.channel.bound),
        f"equations->channel.value.rate = {number(eq.channel.rate)};",
    ]
