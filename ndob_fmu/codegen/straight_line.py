"""The arithmetic of a step as lists of assignments to scalars; `codegen.build_step` puts the statements around them.

Common subexpressions are computed once, terms that are zero are left out. What depends on the parameters alone is
computed once in a run, what depends on parameters and held inputs alone once in a step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import sympy

from ndob_fmu.codegen.hoist import Assignments, Hoist, shared
from ndob_fmu.runtime.numerics.integrate import (
    ABSOLUTE_TOLERANCE,
    ERROR_WEIGHTS,
    NODES,
    RELATIVE_TOLERANCE,
    STAGE_WEIGHTS,
    WEIGHTS,
)


@dataclass(frozen=True)
class RightHandSide:
    """ẋ and y, as pairs of a symbol and its value and as expressions in these symbols.

    x: states (n,)
    d: disturbances (q2,)
    constants: pairs that depend on the parameters only
    held: pairs that depend on constants and inputs
    varying: pairs that depend on states and disturbances too
    derivatives: ẋ (n,)
    outputs: y (p,)
    """

    x: tuple[sympy.Symbol, ...]
    d: tuple[sympy.Symbol, ...]
    constants: Assignments
    held: Assignments
    varying: Assignments
    derivatives: tuple[sympy.Expr, ...]
    outputs: tuple[sympy.Expr, ...]


@dataclass(frozen=True)
class SubstepAssignments:
    """One substep h of Cash and Karp's method.

    assignments: of the stages
    x_at_stages: x at each stage (n,)
    x_after: x at its end (n,)
    errors: assignments of the error of each state
    tolerances: assignments of what is tolerated of each
    judged: the names of error and tolerance for each state
    """

    assignments: Assignments
    x_at_stages: tuple[tuple[sympy.Expr, ...], ...]
    x_after: tuple[sympy.Expr, ...]
    errors: Assignments
    tolerances: Assignments
    judged: tuple[tuple[sympy.Symbol, sympy.Symbol], ...]


@dataclass(frozen=True)
class Correction:
    """The update by a sample.

    innovations: assignments of e = y − h(x̂, u) (p,)
    corrected: assignments of ξ̂ + K e, in the order of ξ̂
    """

    innovations: Assignments
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
    """Take ẋ (n,) and y (p,) apart by what they depend on; every symbol besides x, d and u is a parameter."""
    of_parameters = Hoist("c", frozenset([*x, *d, *u]))
    of_inputs = Hoist("h", frozenset([*x, *d]))
    expressions = [of_inputs(of_parameters(expression)) for expression in [*derivatives, *outputs]]
    n = len(x)
    varying, reduced = shared(expressions[:n], "v")
    held, values = shared(list(of_inputs.names), "g")
    return RightHandSide(
        x=tuple(x),
        d=tuple(d),
        constants=tuple((name, value) for value, name in of_parameters.names.items()),
        held=(*held, *zip(of_inputs.names.values(), values, strict=True)),
        varying=varying,
        derivatives=tuple(reduced),
        outputs=tuple(expressions[n:]),
    )


def substep(rhs: RightHandSide, h: sympy.Symbol, d_at: Sequence[Sequence[sympy.Expr]]) -> SubstepAssignments:
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

    x_at_stages = []
    for i, (weights, d) in enumerate(zip(STAGE_WEIGHTS, d_at, strict=True)):
        x_at_stages.append(tuple(moved_by(weights, f"x{i}_")))
        stage = dict(zip([*rhs.x, *rhs.d], [*x_at_stages[-1], *d], strict=True))
        for name, value in rhs.varying:
            renamed = sympy.Symbol(f"{name.name}_{i}", real=True)
            lines.append((renamed, value.xreplace(stage)))
            stage[name] = renamed
        slopes.append(_named(lines, symbols(f"k{i}_", n), [value.xreplace(stage) for value in rhs.derivatives]))
    x_after = moved_by(WEIGHTS, f"x{len(NODES)}_")
    errors = [h * _combination(ERROR_WEIGHTS, [slope[j] for slope in slopes]) for j in range(n)]
    tolerances = [ABSOLUTE_TOLERANCE + RELATIVE_TOLERANCE * sympy.Abs(value) for value in x_after]
    error_names, tolerance_names = symbols("e_", n), symbols("l", n)
    return SubstepAssignments(
        assignments=tuple(lines),
        x_at_stages=tuple(x_at_stages),
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
        innovations=tuple((e_i, y_i - row) for e_i, y_i, row in zip(e, y, rhs.outputs, strict=True)),
        corrected=tuple(
            (state, state + _combination(row, e)) for state, row in zip([*rhs.x, *delta], gain, strict=True)
        ),
    )


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
