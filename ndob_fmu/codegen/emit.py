"""Write a symbolic model as source text: the module of plain functions that the runtime and the FMUs use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy

from ndob_fmu.codegen.emit_step import STEP_IMPORTS, emit_steps
from ndob_fmu.codegen.python_text import python_text, tuple_text
from ndob_fmu.model.model import Model

_HEADER = '''"""Equations of {name}, written from its symbolic model; do not edit."""

import math

from ndob_fmu.runtime.equations import {names}
{step_imports}
'''

_IMPORTED = ["Equations", "Experiment", "ObserverDefaults", "SignalDefaults", "Steps"]

# What a disturbance with a channel adds: the plant is the one with lumped inputs w, driven by w = n(x, u) d.
_PLANT_WITH_CHANNEL = """def derivatives(_x, _u, _d, _p):
    return lumped_derivatives(_x, _u, [_n * _d[0] for _n in direction(_x, _u, _p)], _p)
"""


def emit_python(model: Model) -> str:
    """Return the text of a Python module that defines EQUATIONS for the model.

    Raises ModelError where an expression has no Python form.
    """
    x, u, d, p = (
        [model.symbols[name] for name in group]
        for group in (model.states, model.inputs, model.disturbances, model.parameters)
    )
    directions = list(model.channel_expressions)
    w = list(sympy.symbols(f"_w:{len(directions)}", real=True)) if directions else d
    f = sympy.Matrix(len(model.f_expressions), 1, list(model.f_expressions))
    derivatives = model.A * sympy.Matrix(x) + model.G_d * sympy.Matrix(w)
    if u:
        derivatives += model.B * sympy.Matrix(u)
    if model.f_expressions:
        derivatives += model.G_f * f
    parts = [
        _HEADER.format(
            name=model.name,
            names=", ".join(["Channel"] * bool(directions) + _IMPORTED),
            step_imports=STEP_IMPORTS,
        ),
        _function(
            "matrices",
            [("_p", p)],
            [*model.A, *model.B, *model.C, *model.G_f, *model.G_d],
            [M.shape for M in (model.A, model.B, model.C, model.G_f, model.G_d)],
        ),
        _function("nonlinearity", [("_x", x), ("_u", u), ("_p", p)], list(f)),
    ]
    if directions:
        parts += [
            _function("direction", [("_x", x), ("_u", u), ("_p", p)], directions),
            _function("lumped_derivatives", [("_x", x), ("_u", u), ("_w", w), ("_p", p)], list(derivatives)),
            _PLANT_WITH_CHANNEL,
        ]
    else:
        parts.append(_function("derivatives", [("_x", x), ("_u", u), ("_d", d), ("_p", p)], list(derivatives)))
    parts += [*emit_steps(model), _equations(model)]
    return "\n\n".join(parts)


def _function(
    name: str,
    arguments: Sequence[tuple[str, Sequence[sympy.Symbol]]],
    expressions: Sequence[sympy.Expr],
    shapes: Sequence[tuple[int, int]] | None = None,
) -> str:
    temporaries = sympy.numbered_symbols("_t", real=True)
    shared, reduced = sympy.cse(list(expressions), symbols=temporaries, list=True) if expressions else ([], [])
    used = set().union(*(e.free_symbols for e in expressions)) if expressions else set()
    lines = [f"def {name}({', '.join(argument for argument, _ in arguments)}):"]
    for argument, symbols in arguments:
        for i, symbol in enumerate(symbols):
            if symbol in used:
                lines.append(f"    {python_text(symbol)} = {argument}[{i}]")
    lines += [f"    {python_text(symbol)} = {python_text(expression)}" for symbol, expression in shared]
    texts = [python_text(expression) for expression in reduced]
    if shapes is None:
        lines.append(f"    return {tuple_text(texts)}")
    else:
        matrices = []
        for rows, columns in shapes:
            own, texts = texts[: rows * columns], texts[rows * columns :]
            matrices.append(tuple_text(tuple_text(own[r * columns : (r + 1) * columns]) for r in range(rows)))
        lines.append("    return (\n" + "".join(f"        {matrix},\n" for matrix in matrices) + "    )")
    return "\n".join(lines) + "\n"


def _equations(model: Model) -> str:
    fields: dict[str, Any] = {
        "name": model.name,
        "description": model.description,
        "states": model.states,
        "inputs": model.inputs,
        "outputs": model.outputs,
        "disturbances": model.disturbances,
        "parameters": {name: float(value) for name, value in model.parameters.items()},
        "units": dict(model.units),
        "descriptions": dict(model.descriptions),
        "x0": model.x0,
        "xhat0": model.xhat0,
        "xhat0_std": model.xhat0_std,
        "disturbance_bound": model.disturbance_bound,
        "disturbance_rate": model.disturbance_rate,
        "lipschitz": float(model.lipschitz or 0.0),
        "f_states": tuple(j for j in range(len(model.states)) if any(entry != 0 for entry in model.jacobian.col(j))),
        "matched": model.matched,
        "observer": model.observer,
        "disturbance": model.disturbance,
        "experiment": model.experiment,
    }
    lines = [f"    {name}={value!r}," for name, value in fields.items()]
    lines += [f"    {name}={name}," for name in ("matrices", "nonlinearity", "derivatives")]
    steps = ("plant_constants", "plant_step", "observer_constants", "observer_step")
    lines.append(f"    steps=Steps({', '.join(f'{name}={name}' for name in steps)}),")
    if model.channel_expressions:
        bounds = f"bound={model.channel_bound!r}, rate={float(model.channel_rate)!r}"
        lines.append(f"    channel=Channel({bounds}, direction=direction, derivatives=lumped_derivatives),")
    return "EQUATIONS = Equations(\n" + "\n".join(lines) + "\n)\n"
