"""The printed functions of a model in the form in which translated code calls them: with arrays and with memory."""

from __future__ import annotations


def thunk(name: str, arity: int, count: int) -> str:
    """Return `call_<name>`, a function of `arity` arrays whose result has `count` numbers."""
    arguments = "".join(f", nd a{i}" for i in range(arity))
    given = "".join(f"flat(arena, a{i}), " for i in range(arity))
    return (
        f"static nd call_{name}(nd_arena *arena, const void *env{arguments}) {{\n"
        f"    nd result = numbers(arena, {count});\n"
        f"    int fault = {name}({given}result.p);\n"
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
        "    int fault = plant_trial(flat(arena, x), flat(arena, u), flat(arena, d), flat(arena, k), h, result.p);\n"
        f"    Trial trial = {{result, result.p[{n}]}};\n"
        f"    trial.x.n[0] = {n};\n"
        "    (void)env;\n"
        "    if (fault) raise_fault(arena, fault);\n"
        "    return trial;\n"
        "}\n"
    )
