"""What defines a plant, its matrices, f, n, ẋ, y and their derivatives, as trees of statements."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import sympy

from ndob_fmu.codegen.hoist import shared
from ndob_fmu.codegen.program import Argument, Function, Return, Value, assignments, element_of_each
from ndob_fmu.codegen.slopes import slopes
from ndob_fmu.model.vector_field import VectorField

# The name of an argument and its elements.
Array = tuple[str, Sequence[sympy.Symbol]]


def build_definitions(field: VectorField) -> dict[str, Callable[[], Function]]:
    """Return, by their names, what builds the functions of `runtime.equations.Equations`, and those of `Channel`.

    Most callers need few of the functions, and those of a large plant take long. Outside the paper's form there are no
    constant matrices.
    """
    x, u, d, p = ("_x", field.x), ("_u", field.u), ("_d", field.d), ("_p", field.p)
    parts = field.parts
    matrices = (parts.A, parts.B, parts.C, parts.G_f, parts.G_d)

    def all_matrices() -> Function:
        entries = [entry for matrix in matrices for entry in matrix]
        return _function("matrices", [p], entries, [M.shape for M in matrices])

    def of_plant(prefix: str, w: Array, driven: Sequence[sympy.Expr]) -> dict[str, Callable[[], Function]]:
        """Return the functions of the plant with the inputs w in place of d, which drive it by `driven`."""
        arguments, name = [x, u, w, p], prefix.__add__
        return {
            name("linearisation"): lambda: _function(
                name("linearisation"), arguments, linearisation(field, driven, w[1])
            ),
            name("input_slopes"): lambda: _function(name("input_slopes"), arguments, input_slopes(field, driven)),
            name("sensitivity"): lambda: _function(name("sensitivity"), arguments, sensitivity(field, driven)),
        }

    def rate(name: str, w: Array) -> dict[str, Callable[[], Function]]:
        return {name: lambda: _function(name, [x, u, w, p], field.derivatives(w[1]))}

    common = {
        **({"matrices": all_matrices} if field.has_paper_form else {}),
        **({"surfaces": lambda: _function("surfaces", [x, u, p], surfaces(field))} if field.jumps_at else {}),
        "nonlinearity": lambda: _function("nonlinearity", [x, u, p], field.f),
        "output": lambda: _function("output", [x, u, p], field.outputs),
        **of_plant("", d, field.driven_by(field.d)),
    }
    if not field.direction:
        return {**common, **rate("derivatives", d)}
    w = ("_w", sympy.symbols(f"_w:{len(field.direction)}", real=True))
    return {
        **common,
        "direction": lambda: _function("direction", [x, u, p], field.direction),
        **rate("lumped_derivatives", w),
        **of_plant("lumped_", w, w[1]),
    }


def linearisation(field: VectorField, w: Sequence[sympy.Expr], d: Sequence[sympy.Symbol]) -> list[sympy.Expr]:
    """Return [[∂ẋ/∂x, ∂ẋ/∂d], [∂y/∂x, 0]], row by row, where w(x, d) acts through the columns of G_d."""
    of_x, of_d = _slopes_of_rates(field, w, field.parts.A, field.x), field.G_d * slopes(w, d)
    of_y = field.parts.C + slopes(field.parts.output_rest, field.x)
    of_state = [entry for i in range(len(field.x)) for entry in (*of_x.row(i), *of_d.row(i))]
    of_output = [entry for i in range(of_y.rows) for entry in (*of_y.row(i), *[sympy.S.Zero] * len(d))]
    return of_state + of_output


def input_slopes(field: VectorField, w: Sequence[sympy.Expr]) -> list[sympy.Expr]:
    """Return [[∂ẋ/∂u], [∂y/∂u]], row by row."""
    of_u = _slopes_of_rates(field, w, field.parts.B, field.u)
    return [*of_u, *slopes(field.parts.output_rest, field.u)]


def _slopes_of_rates(
    field: VectorField, w: Sequence[sympy.Expr], linear: sympy.Matrix, symbols: Sequence[sympy.Symbol]
) -> sympy.Matrix:
    """Return the slopes of ẋ, those of its linear part, of f, of w and of columns of G_d that turn."""
    total = linear + field.parts.G_f * slopes(field.f, symbols) + field.G_d * slopes(w, symbols)
    if not field.directions_are_constant:
        for j, acting in enumerate(w):
            total += slopes(list(field.G_d.col(j)), symbols) * acting
    return total


def sensitivity(field: VectorField, w: Sequence[sympy.Expr]) -> list[sympy.Expr]:
    """Return [[∂ẋ/∂p], [∂y/∂p]], row by row."""
    return list(slopes([*field.derivatives(w), *field.outputs], field.p))


def surfaces(field: VectorField) -> list[sympy.Expr]:
    """Return [g, ∂g/∂x] for each surface g(x, u) = 0 at which ẋ jumps, row by row."""
    of_x = slopes(field.jumps_at, field.x)
    return [entry for i, g in enumerate(field.jumps_at) for entry in (g, *of_x.row(i))]


def _function(
    name: str,
    arguments: Sequence[Array],
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
