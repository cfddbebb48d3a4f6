"""The printed functions of a model in the form in which translated code calls them: with arrays and with memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate


def thunk(name: str, arity: int, count: int) -> str:
    """Return `call_<name>`, a function of `arity` arrays whose result has `count` numbers."""
    arguments = "".join(f", nd a{i}" for i in range(arity))
    given = "".join(f"flat(arena, a{i}), " for i in range(arity))
    return (
        f"static nd call_{name}(nd_arena *arena, const void *env{arguments}) {{\n"
        f"    nd result = numbers(arena, {count});\n"
        f"    int fault = {name}({given}result->p);\n"
        f"    (void)env;\n"
        f"    if (fault) raise_fault(arena, fault);\n"
        f"    return result;\n"
        f"}}\n"
    )


def trial_thunk(n: int) -> str:
    """Return `call_plant_trial` for n states."""
    return (
        "static Trial call_plant_trial(nd_arena *arena, const void *env, nd x, nd u, nd d, nd k, double h) {\n"
        f"    nd result = numbers(arena, {n + 1});\n"
        "    int fault = plant_trial(flat(arena, x), flat(arena, u), flat(arena, d), flat(arena, k), h, result->p);\n"
        f"    Trial trial = {{result, result->p[{n}]}};\n"
        f"    trial.x->n[0] = {n};\n"
        "    (void)env;\n"
        "    if (fault) raise_fault(arena, fault);\n"
        "    return trial;\n"
        "}\n"
    )


def matrices_thunk(shapes: Sequence[tuple[int, int]]) -> str:
    """Return `call_matrices`: the matrices of these shapes, which the printed function writes one behind the other."""
    count = sum(rows * columns for rows, columns in shapes)
    listed = ", ".join(f"{{{rows}, {columns}}}" for rows, columns in shapes)
    return (
        "static l_l_nd call_matrices(nd_arena *arena, const void *env, nd p) {\n"
        f"    static const int shapes[][2] = {{{listed}}};\n"
        f"    l_l_nd found = {{{len(shapes)}, nd_take_bytes(arena, {len(shapes)} * sizeof(nd_list))}};\n"
        f"    nd result = numbers(arena, {count});\n"
        "    double *from = result->p;\n"
        "    int fault = matrices(flat(arena, p), result->p);\n"
        "    (void)env;\n"
        "    if (fault) raise_fault(arena, fault);\n"
        "    for (int k = 0; k < found.n; k++) {\n"
        "        found.p[k].n = shapes[k][0];\n"
        "        found.p[k].p = nd_take_bytes(arena, (size_t)shapes[k][0] * sizeof(nd) + 1);\n"
        "        for (int i = 0; i < shapes[k][0]; i++, from += shapes[k][1])\n"
        "            found.p[k].p[i] = nd_view(arena, shapes[k][1], from);\n"
        "    }\n"
        "    return found;\n"
        "}\n"
    )


def converged_step_thunk(fields: Sequence[str], counts: Mapping[str, int]) -> str:
    """Return `call_observer_step`.

    fields: of the gain, as the printed function takes them
    counts: of the numbers in each field of `ObserverStep`, in their order
    """
    gain = "".join(f"flat(arena, gain->{field}), " for field in fields)
    places = accumulate(counts.values(), initial=0)
    parts = "".join(
        f"    found.value.{name} = nd_view(arena, {count}, result->p + {place});\n"
        for (name, count), place in zip(counts.items(), places, strict=False)
    )
    return (
        "static m_ObserverStep call_observer_step(nd_arena *arena, const void *env, nd xi_hat, nd inputs, nd squares,\n"
        "                                         nd k, const ConvergedGain *gain, double H) {\n"
        "    m_ObserverStep found;\n"
        f"    nd result = numbers(arena, {sum(counts.values())});\n"
        "    int fault = observer_step(flat(arena, xi_hat), flat(arena, inputs), flat(arena, squares),\n"
        f"                              flat(arena, k), {gain}H, result->p);\n"
        "    (void)env;\n"
        "    memset(&found, 0, sizeof found);\n"
        "    if (fault && fault != STOPPED) raise_fault(arena, fault);\n"
        "    found.some = !fault;\n"
        f"{parts}"
        "    return found;\n"
        "}\n"
    )
