"""What defines a plant, its matrices, f, n and ẋ, as trees of statements."""

from __future__ import annotations

from collections.abc import Sequence

import sympy

from ndob_fmu.codegen.program import Argument, Function, Return, Value, assignments, element_of_each
from ndob_fmu.model.vector_field import VectorField


def build_definitions(field: VectorField) -> list[Function]:
    """Return matrices, nonlinearity and derivatives; with a channel also direction and lumped_derivatives."""
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
    return Function(
        name, tuple(Argument(array) for array, _ in arguments), (*read, *assignments(shared), Return(result))
    )


def _matrices(entries: Sequence[sympy.Expr], shapes: Sequence[tuple[int, int]]) -> tuple[Value, ...]:
    following = iter(entries)
    return tuple(tuple(tuple(next(following) for _ in range(columns)) for _ in range(rows)) for rows, columns in shapes)
