"""What defines a plant, its matrices, f, n, ẋ, y and their derivatives, as trees of statements."""

from __future__ import annotations

from collections.abc import Sequence

import sympy

from ndob_fmu.codegen.hoist import shared
from ndob_fmu.codegen.program import Argument, Function, Return, Value, assignments, element_of_each
from ndob_fmu.codegen.slopes import slopes
from ndob_fmu.model.vector_field import VectorField


def build_definitions(field: VectorField) -> list[Function]:
    """Return the functions of `runtime.equations.Equations`; with a channel also those of `Channel`."""
    x, u, d, p = ("_x", field.x), ("_u", field.u), ("_d", field.d), ("_p", field.p)
    matrices = (field.A, field.B, field.C, field.G_f, field.G_d)
    definitions = [
        _function("matrices", [p], [entry for matrix in matrices for entry in matrix], [M.shape for M in matrices]),
        _function("nonlinearity", [x, u, p], field.f),
        _function("output", [x, u, p], field.outputs),
        _function("linearisation", [x, u, d, p], _linearisation(field, field.driven_by(field.d), field.d)),
        _function("input_slopes", [x, u, d, p], _input_slopes(field, field.driven_by(field.d))),
        _function("sensitivity", [x, u, d, p], _sensitivity(field, field.driven_by(field.d))),
    ]
    if not field.direction:
        return [*definitions, _function("derivatives", [x, u, d, p], field.derivatives(field.d))]
    lumped = sympy.symbols(f"_w:{len(field.direction)}", real=True)
    w = ("_w", lumped)
    return [
        *definitions,
        _function("direction", [x, u, p], field.direction),
        _function("lumped_derivatives", [x, u, w, p], field.derivatives(lumped)),
        _function("lumped_linearisation", [x, u, w, p], _linearisation(field, lumped, lumped)),
        _function("lumped_input_slopes", [x, u, w, p], _input_slopes(field, lumped)),
        _function("lumped_sensitivity", [x, u, w, p], _sensitivity(field, lumped)),
    ]


def _linearisation(field: VectorField, w: Sequence[sympy.Expr], d: Sequence[sympy.Symbol]) -> list[sympy.Expr]:
    """Return [[∂ẋ/∂x, ∂ẋ/∂d], [∂y/∂x, 0]], row by row, where w(x, d) acts through the columns of G_d."""
    of_x = field.A + field.G_f * slopes(field.f, field.x) + field.G_d * slopes(w, field.x)
    of_d = field.G_d * slopes(w, d)
    rows = sympy.Matrix([[of_x, of_d], [field.C, sympy.zeros(field.C.rows, len(d))]])
    return list(rows)


def _input_slopes(field: VectorField, w: Sequence[sympy.Expr]) -> list[sympy.Expr]:
    """Return ∂ẋ/∂u, row by row."""
    return list(field.B + field.G_f * slopes(field.f, field.u) + field.G_d * slopes(w, field.u))


def _sensitivity(field: VectorField, w: Sequence[sympy.Expr]) -> list[sympy.Expr]:
    """Return [[∂ẋ/∂p], [∂y/∂p]], row by row."""
    return list(slopes([*field.derivatives(w), *field.outputs], field.p))


def _function(
    name: str,
    arguments: Sequence[tuple[str, Sequence[sympy.Symbol]]],
    expressions: Sequence[sympy.Expr],
    shapes: Sequence[tuple[int, int]] | None = None,
) -> Function:
    """Return the function that returns the expressions, as matrices where they have shapes."""
    found, reduced = shared(expressions, "t")
    read = [element for array, symbols in arguments for element in element_of_each(symbols, array, expressions)]
    result = tuple(reduced) if shapes is None else _matrices(reduced, shapes)
    return Function(
        name, tuple(Argument(array) for array, _ in arguments), (*read, *assignments(found), Return(result))
    )


def _matrices(entries: Sequence[sympy.Expr], shapes: Sequence[tuple[int, int]]) -> tuple[Value, ...]:
    following = iter(entries)
    return tuple(tuple(tuple(next(following) for _ in range(columns)) for _ in range(rows)) for rows, columns in shapes)
