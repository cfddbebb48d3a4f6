"""Derivatives of a model's expressions that can be printed, also where the expressions have kinks and jumps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import sympy

from ndob_fmu.codegen.print_python import has_python_form

# Their slope is 0 where they have one.
_STEPS = (sympy.sign, sympy.Heaviside, sympy.floor, sympy.ceiling)
# SymPy's forms of a derivative that it does not know.
_UNKNOWN = (sympy.Derivative, sympy.Subs, sympy.DiracDelta, sympy.nan, sympy.zoo, sympy.oo, -sympy.oo)
_DIFFERENCE = sympy.Float(1e-6)


class _Magnitude(sympy.Function):  # type: ignore[misc]
    """|e| of a real e. The derivative of SymPy's Abs falls apart into Re and Im where e may be complex."""

    is_extended_real = True
    is_extended_nonnegative = True

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        return sympy.sign(self.args[0])


def slopes(expressions: Sequence[sympy.Expr], symbols: Sequence[sympy.Symbol]) -> sympy.Matrix:
    """Return the derivative of each expression (rows) with respect to each symbol (columns).

    A jump (sign, Heaviside, floor, Mod) has the slope 0, |e| has sign(e) e', and a Min, a Max or a Piecewise has the
    slope of the branch taken. Where SymPy finds nothing that can be printed, a central difference stands in its place.
    """
    result = sympy.zeros(len(expressions), len(symbols))
    for i, expression in enumerate(expressions):
        within = expression.free_symbols
        if within.isdisjoint(symbols):
            continue
        smooth, jumps = _without_jumps(expression)
        for j, symbol in enumerate(symbols):
            if symbol in within:
                result[i, j] = _slope(expression, smooth, jumps, symbol)
    return result


def _slope(
    expression: sympy.Expr, smooth: sympy.Expr, jumps: Sequence[tuple[sympy.Symbol, sympy.Expr]], symbol: sympy.Symbol
) -> sympy.Expr:
    found = sympy.diff(smooth, symbol)
    if any(not power.exp.is_number for power in found.atoms(sympy.Pow)):
        found = sympy.powsimp(found)  # k x^k / x has no value at 0, k x^(k - 1) may have one
    for jump, value in reversed(jumps):
        found = found.xreplace({jump: value})
    found = found.replace(_Magnitude, sympy.Abs)
    known = not found.has(*_UNKNOWN) and has_python_form(found)
    if known or not has_python_form(expression):  # the printer refuses such an expression by its name
        return found
    h = _DIFFERENCE * (1 + sympy.Abs(symbol))
    return (expression.xreplace({symbol: symbol + h}) - expression.xreplace({symbol: symbol - h})) / (2 * h)


def _without_jumps(expression: sympy.Expr) -> tuple[sympy.Expr, list[tuple[sympy.Symbol, sympy.Expr]]]:
    """Return the expression with a constant in place of every part that jumps, and these parts, the inner ones first.

    A Min or Max becomes a Piecewise, so that only the derivative of the branch taken is evaluated.
    """
    expression = expression.replace(
        lambda part: isinstance(part, sympy.Mod | sympy.frac), lambda part: part.rewrite(sympy.floor)
    )
    expression = _by_branches(expression).replace(sympy.Abs, _Magnitude)
    jumps: list[tuple[sympy.Symbol, sympy.Expr]] = []
    for part in _inner_first(expression.atoms(*_STEPS)):
        for jump, value in jumps:
            part = part.xreplace({value: jump})
        jumps.append((sympy.Dummy(real=True), part))
        expression = expression.xreplace({part: jumps[-1][0]})
    return expression, jumps


def _by_branches(expression: sympy.Expr) -> sympy.Expr:
    """Return the expression with a Piecewise in place of every Min and Max; those in conditions stay."""
    if isinstance(expression, sympy.logic.boolalg.Boolean) or not expression.has(sympy.Min, sympy.Max):
        return expression
    if not isinstance(expression, sympy.Min | sympy.Max):
        return expression.func(*map(_by_branches, expression.args))
    first, rest = expression.args[0], expression.func(*expression.args[1:])
    wins = first >= rest if isinstance(expression, sympy.Max) else first <= rest
    return sympy.Piecewise((_by_branches(first), wins), (_by_branches(rest), True))


def _inner_first(parts: Iterable[sympy.Expr]) -> list[sympy.Expr]:
    return sorted(parts, key=lambda part: (part.count_ops(), str(part)))
