"""From ẋ and y as they stand in a textbook to what is constant in them, and what is not.

    ẋ = A x + B u + G_f f(x, u) + G_d(x, u) d,   y = C x + g(x, u)

A term belongs to A, B or C where it is a state or an input times an expression in the parameters, to f or g otherwise.
The result equals what was given exactly: nothing is linearised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import sympy

from ndob_fmu.model.expressions import same_matrix

Symbols = Sequence[sympy.Symbol]
_LONG = 300  # operations: longer expressions are compared as they stand, without transformations


class NotAffineError(Exception):
    """A derivative is not affine in the disturbances; `state` is its index, `disturbance` the symbol at fault."""

    def __init__(self, state: int, disturbance: sympy.Symbol) -> None:
        super().__init__(state, disturbance)
        self.state, self.disturbance = state, disturbance


@dataclass(frozen=True)
class AffineSplit:
    """The parts of ẋ and y; without f, G_f has no columns.

    A (n,n), B (n,m), C (p,n), G_f (n,q1): in the parameters
    G_d (n,k): in the parameters; in x and u too where several disturbances have such a direction
    f (q1,), direction (k,), output_rest (p,): in x, u and the parameters; `direction` is empty without a channel
    """

    A: sympy.ImmutableMatrix
    B: sympy.ImmutableMatrix
    C: sympy.ImmutableMatrix
    G_f: sympy.ImmutableMatrix
    G_d: sympy.ImmutableMatrix
    f: tuple[sympy.Expr, ...]
    direction: tuple[sympy.Expr, ...]
    output_rest: tuple[sympy.Expr, ...]


def split(
    derivatives: Sequence[sympy.Expr],
    outputs: Sequence[sympy.Expr],
    x: Symbols,
    u: Symbols,
    d: Symbols,
    *,
    channel: bool,
) -> AffineSplit:
    """Take ẋ (n,) and y (p,) apart; `channel`: a single direction that depends on x or u becomes n(x, u).

    Raises NotAffineError.
    """
    drift, directions = _affine_in(derivatives, d)
    A, B, rest = _linear_part(drift, x, u)
    C, D, output_rest = _linear_part(outputs, x, u)
    if u:
        fed_through = D * sympy.Matrix(u)
        output_rest = [g + part for g, part in zip(output_rest, fed_through, strict=True)]
    varying = bool(directions.free_symbols & {*x, *u})
    direction: tuple[sympy.Expr, ...] = ()
    if varying and channel:
        rows = [i for i in range(directions.rows) if directions[i, 0] != 0]
        direction = tuple(directions[i, 0] for i in rows)
        directions, varying = _unit_columns(directions.rows, rows), False
    G_f, f = _channels(rest, directions, {*x, *u}, may_match=not varying)
    return AffineSplit(
        A=A,
        B=B,
        C=C,
        G_f=G_f,
        G_d=sympy.ImmutableMatrix(directions),
        f=f,
        direction=direction,
        output_rest=tuple(output_rest),
    )


def with_known_part(parts: AffineSplit, known: Sequence[sympy.Expr], variables: set[sympy.Symbol]) -> AffineSplit:
    """Return the parts of ẋ with d + known (q2,) in place of d; `variables`: the states and inputs."""
    varying = bool(parts.G_d.free_symbols & variables)
    if not varying and (not parts.f or same_matrix(parts.G_f, parts.G_d)):
        f = parts.f or (sympy.S.Zero,) * len(known)
        return replace(parts, G_f=parts.G_d, f=tuple(one + more for one, more in zip(f, known, strict=True)))
    rest = parts.G_d * sympy.Matrix(known)
    if parts.f:
        rest += parts.G_f * sympy.Matrix(parts.f)
    G_f, f = _channels(list(rest), sympy.Matrix(parts.G_d), variables, may_match=False)
    return replace(parts, G_f=G_f, f=f)


def _affine_in(expressions: Sequence[sympy.Expr], d: Symbols) -> tuple[list[sympy.Expr], sympy.Matrix]:
    """Return what is left for d = 0 (n,), and the slopes with respect to d (n,q2). Raises NotAffineError."""
    slopes = sympy.zeros(len(expressions), len(d))
    for i, expression in enumerate(expressions):
        for j, disturbance in enumerate(d):
            if disturbance in expression.free_symbols:
                if _is_cased_by(expression, {disturbance}):
                    raise NotAffineError(i, disturbance)
                slopes[i, j] = _free_of(sympy.diff(expression, disturbance), d)
                if slopes[i, j].free_symbols & {*d} or slopes[i, j].has(sympy.Derivative, sympy.Subs):
                    raise NotAffineError(i, disturbance)
    nothing = dict.fromkeys(d, sympy.S.Zero)
    return [expression.xreplace(nothing) for expression in expressions], slopes


def _is_cased_by(expression: sympy.Expr, variables: set[sympy.Symbol]) -> bool:
    """Return whether variables choose between cases, which may be constants, so that no slope shows them."""
    conditions = (condition for cases in expression.atoms(sympy.Piecewise) for _, condition in cases.args)
    return any(condition.free_symbols & variables for condition in conditions)


def _free_of(slope: sympy.Expr, d: Symbols) -> sympy.Expr:
    """Return the slope in a form without d, where one is found."""
    for transform in (sympy.expand, sympy.cancel, sympy.simplify):
        # To look for a form that does not exist may take SymPy many minutes.
        if not (slope.free_symbols & {*d}) or _changes_with(d, slope):
            break
        slope = transform(slope)
    return slope


def _changes_with(d: Symbols, slope: sympy.Expr) -> bool:
    """Return whether a slope has different values for two d, with all else the same; False where it has no value."""
    others = sorted(slope.free_symbols - {*d}, key=str)
    point = {symbol: sympy.Float(0.3 + 0.37 * i) for i, symbol in enumerate(others)}
    try:
        first, second = (
            complex(slope.xreplace(point | dict.fromkeys(d, sympy.Float(value))).evalf()) for value in (0.2, 0.7)
        )
    except (TypeError, ValueError):
        return False
    return bool(abs(first - second) > 1e-6 * (abs(first) + abs(second)))


def _linear_part(
    expressions: Sequence[sympy.Expr], x: Symbols, u: Symbols
) -> tuple[sympy.ImmutableMatrix, sympy.ImmutableMatrix, list[sympy.Expr]]:
    """Return the constant slopes with respect to x and u, and what they leave of the expressions."""
    variables = (*x, *u)
    slopes = sympy.zeros(len(expressions), len(variables))
    rest = []
    for i, expression in enumerate(expressions):
        left = []
        for term in _terms(expression, {*variables}):
            found = {symbol: sympy.diff(term, symbol) for symbol in variables if symbol in term.free_symbols}
            constant = not any(slope.free_symbols & {*variables} for slope in found.values())
            if found and constant and not _is_cased_by(term, {*variables}):
                for symbol, slope in found.items():
                    slopes[i, variables.index(symbol)] += slope
                left.append(term.xreplace(dict.fromkeys(variables, sympy.S.Zero)))
            else:
                left.append(term)
        rest.append(sympy.Add(*left))
    n = len(x)
    return sympy.ImmutableMatrix(slopes[:, :n]), sympy.ImmutableMatrix(slopes[:, n:]), rest


def _terms(expression: sympy.Expr, variables: set[sympy.Symbol]) -> list[sympy.Expr]:
    """Return the terms of a sum, with constant factors multiplied out: k (x₁ − sin x₂) has two."""
    found = []
    for term in sympy.Add.make_args(expression):
        constant, factor = term.as_independent(*variables, as_Add=False)
        if constant != 1 and factor.is_Add:
            found += [part for inner in factor.args for part in _terms(constant * inner, variables)]
        else:
            found.append(term)
    return found


def _channels(
    rest: Sequence[sympy.Expr], G_d: sympy.Matrix, variables: set[sympy.Symbol], *, may_match: bool
) -> tuple[sympy.ImmutableMatrix, tuple[sympy.Expr, ...]]:
    """Return G_f and f with G_f f = rest: in the disturbances' channel where all of it enters there (eq. 1)."""
    rows = [i for i, part in enumerate(rest) if part != 0]
    if not rows:
        return sympy.ImmutableMatrix.zeros(len(rest), 0), ()
    if may_match:
        matched = _through(G_d, rest, variables)
        if matched is not None:
            return sympy.ImmutableMatrix(G_d), matched
    columns: list[list[sympy.Expr]] = []
    f: list[sympy.Expr] = []
    for i in rows:
        for column, function in zip(columns, f, strict=True):
            ratio = _ratio(rest[i], function)
            if not (ratio.free_symbols & variables):
                column[i] = ratio
                break
        else:
            columns.append([sympy.S.One if k == i else sympy.S.Zero for k in range(len(rest))])
            f.append(rest[i])
    return sympy.ImmutableMatrix(columns).T, tuple(f)


def _through(
    G_d: sympy.Matrix, rest: Sequence[sympy.Expr], variables: set[sympy.Symbol]
) -> tuple[sympy.Expr, ...] | None:
    """Return φ with G_d φ = rest; None where there is none, or G_d has dependent columns."""
    _, pivots = G_d.T.rref()
    if len(pivots) < G_d.cols or any(part != 0 and not any(G_d[i, :]) for i, part in enumerate(rest)):
        return None
    square = G_d.extract(list(pivots), list(range(G_d.cols)))
    found = square.LUsolve(sympy.Matrix([rest[i] for i in pivots])).applyfunc(lambda part: _divided(part, variables))
    left = G_d * found - sympy.Matrix(rest)
    return tuple(found) if all(_is_zero(part) for part in left) else None


def _divided(expression: sympy.Expr, variables: set[sympy.Symbol]) -> sympy.Expr:
    """Return a sum over a constant as a sum of terms, in each of which the constant cancels."""
    constant, factor = expression.as_independent(*variables, as_Add=False)
    if factor.is_Add and constant != 1:
        return sympy.Add(*(constant * part for part in factor.args))
    return expression


def _ratio(one: sympy.Expr, other: sympy.Expr) -> sympy.Expr:
    ratio = one / other
    return sympy.cancel(ratio) if ratio.count_ops() <= _LONG else ratio


def _is_zero(expression: sympy.Expr) -> bool:
    if expression == 0:
        return True
    return bool(expression.count_ops() <= _LONG and sympy.simplify(expression) == 0)


def _unit_columns(rows: int, places: Sequence[int]) -> sympy.Matrix:
    return sympy.Matrix(rows, len(places), lambda i, j: 1 if i == places[j] else 0)
