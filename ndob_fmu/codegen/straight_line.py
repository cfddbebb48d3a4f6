"""The work of a step as lists of assignments: scalars only, what is shared computed once, zeros left out.

`codegen.build_step` puts statements around them.
What depends on the parameters alone is set apart, for it is computed once, and what depends on the held inputs besides,
for that is computed once in a step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import sympy

from ndob_fmu.runtime.numerics.integrate import (
    ABSOLUTE_TOLERANCE,
    ERROR_WEIGHTS,
    NODES,
    RELATIVE_TOLERANCE,
    STAGE_WEIGHTS,
    WEIGHTS,
)

Assignments = tuple[tuple[sympy.Symbol, sympy.Expr], ...]


@dataclass(frozen=True)
class RightHandSide:
    """ẋ and C x: `constants` of p, `held` of u besides, `varying` of x and d besides, and the expressions in all these.

    constants and held are pairs of a symbol and its value; derivatives (n,) and outputs (p,) use their symbols.
    """

    x: tuple[sympy.Symbol, ...]
    d: tuple[sympy.Symbol, ...]
    constants: Assignments
    held: Assignments
    varying: Assignments
    derivatives: tuple[sympy.Expr, ...]
    outputs: tuple[sympy.Expr, ...]


@dataclass(frozen=True)
class Trial:
    """One substep h of Cash and Karp's method: x_after (n,), its `errors`, and the `tolerances` of them.

    judged: the names of error and tolerance for each state.
    """

    assignments: Assignments
    x_after: tuple[sympy.Expr, ...]
    errors: Assignments
    tolerances: Assignments
    judged: tuple[tuple[sympy.Symbol, sympy.Symbol], ...]


@dataclass(frozen=True)
class Correction:
    """The update by a sample: its residuals e (p,), and ξ̂ + K e in the order of ξ̂."""

    residuals: Assignments
    corrected: Assignments


def symbols(stem: str, count: int) -> tuple[sympy.Symbol, ...]:
    """Return real symbols with names that no model can use: _stem0, _stem1, …."""
    return tuple(sympy.Symbol(f"_{stem}{index}", real=True) for index in range(count))


def right_hand_side(
    derivatives: Sequence[sympy.Expr],
    outputs: Sequence[sympy.Expr],
    x: Sequence[sympy.Symbol],
    d: Sequence[sympy.Symbol],
    u: Sequence[sympy.Symbol],
) -> RightHandSide:
    """Take ẋ (n,) and C x (p,) apart by what they depend on; every symbol besides x, d and u is a parameter."""
    of_parameters = _Hoist("c", frozenset([*x, *d, *u]))
    of_inputs = _Hoist("h", frozenset([*x, *d]))
    expressions = [of_inputs(of_parameters(expression)) for expression in [*derivatives, *outputs]]
    n = len(x)
    varying, reduced = _shared(expressions[:n], "v")
    held, values = _shared(list(of_inputs.names), "g")
    return RightHandSide(
        x=tuple(x),
        d=tuple(d),
        constants=tuple((name, value) for value, name in of_parameters.names.items()),
        held=(*held, *zip(of_inputs.names.values(), values, strict=True)),
        varying=varying,
        derivatives=tuple(reduced),
        outputs=tuple(expressions[n:]),
    )


def trial(rhs: RightHandSide, h: sympy.Symbol, d_at: Sequence[Sequence[sympy.Expr]]) -> Trial:
    """Return a substep h from rhs.x, with the disturbance d_at[i] (q2,) at stage i."""
    n = len(rhs.x)
    first_h = sympy.Symbol("_f", real=True)
    lines: list[tuple[sympy.Symbol, sympy.Expr]] = [(first_h, sympy.Float(NODES[1]) * h)]
    slopes: list[list[sympy.Expr]] = []

    def moved_by(weights: Sequence[float], stem: str) -> list[sympy.Expr]:
        moved = [rhs.x[j] + h * _combination(weights, [slope[j] for slope in slopes]) for j in range(n)]
        if len(weights) == 1:
            moved = [rhs.x[j] + first_h * slopes[0][j] for j in range(n)]
        return _named(lines, symbols(stem, n), moved)

    for i, (weights, d) in enumerate(zip(STAGE_WEIGHTS, d_at, strict=True)):
        stage = dict(zip([*rhs.x, *rhs.d], [*moved_by(weights, f"x{i}_"), *d], strict=True))
        for name, value in rhs.varying:
            renamed = sympy.Symbol(f"{name.name}_{i}", real=True)
            lines.append((renamed, value.xreplace(stage)))
            stage[name] = renamed
        slopes.append(_named(lines, symbols(f"k{i}_", n), [value.xreplace(stage) for value in rhs.derivatives]))
    x_after = moved_by(WEIGHTS, f"x{len(NODES)}_")
    errors = [h * _combination(ERROR_WEIGHTS, [slope[j] for slope in slopes]) for j in range(n)]
    tolerances = [ABSOLUTE_TOLERANCE + RELATIVE_TOLERANCE * sympy.Abs(value) for value in x_after]
    error_names, tolerance_names = symbols("e_", n), symbols("l", n)
    return Trial(
        assignments=tuple(lines),
        x_after=tuple(x_after),
        errors=tuple(zip(error_names, errors, strict=True)),
        tolerances=tuple(zip(tolerance_names, tolerances, strict=True)),
        judged=tuple(zip(error_names, tolerance_names, strict=True)),
    )


def correction(
    rhs: RightHandSide,
    delta: Sequence[sympy.Symbol],
    y: Sequence[sympy.Symbol],
    gain: Sequence[Sequence[sympy.Symbol]],
) -> Correction:
    """Return the update of ξ̂ = [x; delta] by a sample y (p,) with the gain K (N,p)."""
    e = symbols("e", len(y))
    return Correction(
        residuals=tuple((e_i, y_i - row) for e_i, y_i, row in zip(e, y, rhs.outputs, strict=True)),
        corrected=tuple(
            (state, state + _combination(row, e)) for state, row in zip([*rhs.x, *delta], gain, strict=True)
        ),
    )


@dataclass
class _Hoist:
    """Puts a name in place of every part of an expression, as large as it may be, that `varying` is not in."""

    stem: str
    varying: frozenset[sympy.Symbol]
    names: dict[sympy.Expr, sympy.Symbol] = field(default_factory=dict)

    def __call__(self, expression: sympy.Expr) -> sympy.Expr:
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


def _shared(expressions: Sequence[sympy.Expr], stem: str) -> tuple[Assignments, list[sympy.Expr]]:
    if not expressions:
        return (), []
    names = sympy.numbered_symbols(f"_{stem}", real=True)
    shared, reduced = sympy.cse(list(expressions), symbols=names, list=True)
    return tuple(shared), reduced


def _named(
    lines: list[tuple[sympy.Symbol, sympy.Expr]], names: Iterable[sympy.Symbol], values: Iterable[sympy.Expr]
) -> list[sympy.Expr]:
    """Append assignments of what is more than a number or a symbol, and return what stands for each value."""
    standing = []
    for name, value in zip(names, values, strict=True):
        if not value.is_Atom:
            lines.append((name, value))
        standing.append(value if value.is_Atom else name)
    return standing


def _combination(weights: Sequence[float | sympy.Expr], terms: Sequence[sympy.Expr]) -> sympy.Expr:
    used = [(weight, term) for weight, term in zip(weights, terms, strict=False) if weight != 0 and term != 0]
    return sympy.Add(*(_number(weight) * term for weight, term in used))


def _number(weight: float | sympy.Expr) -> sympy.Expr:
    return weight if isinstance(weight, sympy.Expr) else sympy.Float(weight)
