"""Write a symbolic model as source text: the module of plain functions that the runtime and the FMUs use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy

from ndob_fmu.codegen.build_step import build_steps
from ndob_fmu.codegen.print_python import IMPORTS, print_function
from ndob_fmu.codegen.program import Function, Return, Value, assignments, element_of_each
from ndob_fmu.model.model import Model
from ndob_fmu.model.vector_field import VectorField

_HEADER = '''"""Equations of {name}, written from its symbolic model; do not edit."""

{imports}
from ndob_fmu.runtime.equations import {names}
from ndob_fmu.runtime.generated_steps import Steps
'''

_IMPORTED = ["Equations", "Experiment", "ObserverDefaults", "SignalDefaults"]

# What a disturbance with a channel adds: the plant is the one with lumped inputs w, driven by w = n(x, u) d.
_PLANT_WITH_CHANNEL = """def derivatives(_x, _u, _d, _p):
    return lumped_derivatives(_x, _u, [_n * _d[0] for _n in direction(_x, _u, _p)], _p)
"""


def emit_python(model: Model) -> str:
    """Return the text of a Python module that defines EQUATIONS for the model.

    Raises ModelError where an expression has no Python form.
    """
    field = model.vector_field
    imported = ", ".join(["Channel"] * bool(field.direction) + _IMPORTED)
    parts = [
        _HEADER.format(name=model.name, imports=IMPORTS, names=imported),
        *map(print_function, _definitions(field)),
        *([_PLANT_WITH_CHANNEL] if field.direction else []),
        *map(print_function, build_steps(field)),
        _equations(model),
    ]
    return "\n\n".join(parts)


def _definitions(field: VectorField) -> list[Function]:
    """Return the functions that `Equations` consists of besides the steps."""
    x, u, p = ("_x", field.x), ("_u", field.u), ("_p", field.p)
    matrices = (field.A, field.B, field.C, field.G_f, field.G_d)
    definitions = [
        _function("matrices", [p], [entry for matrix in matrices for entry in matrix], [M.shape for M in matrices]),
        _function("nonlinearity", [x, u, p], field.f),
    ]
    if not field.direction:
        return [*definitions, _function("derivatives", [x, u, ("_d", field.d), p], field.derivatives(field.d))]
    w = sympy.symbols(f"_w:{len(field.direction)}", real=True)
    return [
        *definitions,
        _function("direction", [x, u, p], field.direction),
        _function("lumped_derivatives", [x, u, ("_w", w), p], field.derivatives(w)),
    ]


def _function(
    name: str,
    arguments: Sequence[tuple[str, Sequence[sympy.Symbol]]],
    expressions: Sequence[sympy.Expr],
    shapes: Sequence[tuple[int, int]] | None = None,
) -> Function:
    """Return the function that returns the expressions, as matrices where they have shapes."""
    temporaries = sympy.numbered_symbols("_t", real=True)
    shared, reduced = sympy.cse(list(expressions), symbols=temporaries, list=True) if expressions else ([], [])
    read = [element for array, symbols in arguments for element in element_of_each(symbols, array, expressions)]
    result = tuple(reduced) if shapes is None else _matrices(reduced, shapes)
    return Function(name, tuple(array for array, _ in arguments), (*read, *assignments(shared), Return(result)))


def _matrices(entries: Sequence[sympy.Expr], shapes: Sequence[tuple[int, int]]) -> tuple[Value, ...]:
    following = iter(entries)
    return tuple(tuple(tuple(next(following) for _ in range(columns)) for _ in range(rows)) for rows, columns in shapes)


def _equations(model: Model) -> str:
    jacobian = model.vector_field.jacobian
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
        "f_states": tuple(j for j in range(len(model.states)) if any(entry != 0 for entry in jacobian.col(j))),
        "matched": model.matched,
        "observer": model.observer,
        "disturbance": model.disturbance,
        "experiment": model.experiment,
    }
    lines = [f"    {name}={value!r}," for name, value in fields.items()]
    lines += [f"    {name}={name}," for name in ("matrices", "nonlinearity", "derivatives")]
    steps = ("plant_constants", "plant_trial", "observer_constants", "observer_step")
    lines.append(f"    steps=Steps({', '.join(f'{name}={name}' for name in steps)}),")
    if model.channel_expressions:
        bounds = f"bound={model.channel_bound!r}, rate={float(model.channel_rate)!r}"
        lines.append(f"    channel=Channel({bounds}, direction=direction, derivatives=lumped_derivatives),")
    return "EQUATIONS = Equations(\n" + "\n".join(lines) + "\n)\n"
