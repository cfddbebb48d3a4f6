"""Take apart expressions by what they depend on, so that what stays the same is computed once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import sympy

Assignments = tuple[tuple[sympy.Symbol, sympy.Expr], ...]


@dataclass
class Hoist:
    """Replaces the largest parts of expressions that do not depend on `varying` by names.

    stem: of the names, which are _stem0, _stem1, …
    varying: the symbols that no replaced part contains
    names: the parts that were replaced, and their names
    """

    stem: str
    varying: frozenset[sympy.Symbol]
    names: dict[sympy.Expr, sympy.Symbol] = field(default_factory=dict)

    def __call__(self, expression: sympy.Expr) -> sympy.Expr:
        """Return the expression with names in it."""
        if expression.is_Atom:
            return expression
        if not (expression.free_symbols & self.varying):
            return self._name(expression)
        if not isinstance(expression, sympy.Expr) or isinstance(expression, sympy.Piecewise):
            # A branch that is not taken may hold what cannot be evaluated.
            return expression
        if isinstance(expression, sympy.Mul):
            coefficient, rest = self._factors(expression)
            return self._named(coefficient) * rest
        if isinstance(expression, sympy.Add):
            own = [part for part in expression.args if not (part.free_symbols & self.varying)]
            return sympy.Add(self(sympy.Add(*own)), *self._collected([p for p in expression.args if p not in own]))
        return expression.func(*(self(part) for part in expression.args))

    def _collected(self, terms: Sequence[sympy.Expr]) -> list[sympy.Expr]:
        """Return k (x_1 - x_2) for k x_1 - k x_2, as springs and flows have it."""
        of_coefficient: dict[sympy.Expr, list[sympy.Expr]] = {}
        for term in terms:
            coefficient, rest = self._factors(term)
            sign = -1 if coefficient.could_extract_minus_sign() else 1
            of_coefficient.setdefault(sign * coefficient, []).append(sign * rest)
        collected = []
        for coefficient, parts in of_coefficient.items():
            if coefficient == 1 or len(parts) == 1:
                collected += [self._named(coefficient) * part for part in parts]
                continue
            total = sympy.Add(*parts)
            sign = -1 if total.could_extract_minus_sign() else 1
            # A number would be multiplied out again, a name is not.
            collected.append(sign * self._name(coefficient) * (sign * total))
        return collected

    def _factors(self, term: sympy.Expr) -> tuple[sympy.Expr, sympy.Expr]:
        """Return what `varying` is not in, and the rest with names in it."""
        own = [part for part in sympy.Mul.make_args(term) if not (part.free_symbols & self.varying)]
        rest = [self(part) for part in sympy.Mul.make_args(term) if part.free_symbols & self.varying]
        return sympy.Mul(*own), sympy.Mul(*rest)

    def _named(self, coefficient: sympy.Expr) -> sympy.Expr:
        """Return a number or a symbol, with its sign, or else a name for it."""
        sign = -1 if coefficient.could_extract_minus_sign() else 1
        return sign * self(sign * coefficient)

    def _name(self, expression: sympy.Expr) -> sympy.Symbol:
        if expression.is_Symbol:
            return expression
        return self.names.setdefault(expression, sympy.Symbol(f"_{self.stem}{len(self.names)}", real=True))


def shared(expressions: Sequence[sympy.Expr], stem: str) -> tuple[Assignments, list[sympy.Expr]]:
    """Return assignments of what occurs more than once, and the expressions in their names _stem0, _stem1, ….

    A Piecewise is shared as a whole only: a part of a branch that is not taken may have no value.
    """
    compound = [expression for expression in expressions if not expression.is_Atom]
    if not compound:
        return (), list(expressions)
    outermost: dict[sympy.Expr, sympy.Symbol] = {}
    outside = [_without_branches(expression, stem, outermost) for expression in compound]
    names = sympy.numbered_symbols(f"_{stem}", real=True)
    found, reduced = sympy.cse(outside, symbols=names, list=True)
    following = iter(reduced)
    results = [expression if expression.is_Atom else next(following) for expression in expressions]
    return (*((name, value) for value, name in outermost.items()), *found), results


def _without_branches(expression: sympy.Expr, stem: str, outermost: dict[sympy.Expr, sympy.Symbol]) -> sympy.Expr:
    """Return the expression with a name in place of every outermost Piecewise."""
    if isinstance(expression, sympy.Piecewise):
        return outermost.setdefault(expression, sympy.Symbol(f"_{stem}_branch{len(outermost)}", real=True))
    if not expression.has(sympy.Piecewise):
        return expression
    return expression.func(*(_without_branches(part, stem, outermost) for part in expression.args))
