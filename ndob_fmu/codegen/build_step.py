"""The steps of plant and observer as trees of statements, around the assignments of `straight_line`.

They do what `Plant.step_by_definition` and `SampledObserver.step_by_definition` define with NumPy, and take the same
decisions. `runtime.generated_steps` describes arguments and results.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from sys import float_info
from types import MappingProxyType

import sympy

from ndob_fmu.codegen.hoist import shared
from ndob_fmu.codegen.program import (
    All,
    AnyNonzero,
    Argument,
    Assign,
    Break,
    Call,
    Compare,
    Fail,
    Function,
    If,
    Keep,
    Kept,
    Loop,
    Not,
    Record,
    Return,
    Statement,
    SumIsFinite,
    Unpack,
    Within,
    assignments,
    element_of_each,
)
from ndob_fmu.codegen.straight_line import (
    RightHandSide,
    SubstepAssignments,
    correction,
    right_hand_side,
    substep,
    symbols,
)
from ndob_fmu.model.vector_field import VectorField
from ndob_fmu.runtime.equations import HIGHEST_ORDER
from ndob_fmu.runtime.generated_steps import MEMORY
from ndob_fmu.runtime.numerics.integrate import ABSOLUTE_TOLERANCE, NODES

Symbols = Sequence[sympy.Symbol]
Ranges = Mapping[str, Sequence[float]]

H, SUBSTEP, NORM = (sympy.Symbol(name, real=True) for name in ("_H", "_h", "_norm"))
LARGEST = sympy.Float(float_info.max)


def build_steps(field: VectorField, ranges: Ranges = MappingProxyType({})) -> dict[str, Callable[[], Function]]:
    """Return, by their names, what builds plant_constants, plant_trial, observer_constants and observer_step.

    ranges: of states and inputs that ẋ or y are not linear in, by name; the observer's step fails where it leaves one
    """
    # To the plant n(x, u) d is a function of x; the observer estimates it as inputs of their own.
    lumped = symbols("w", field.G_d.cols)
    x, u, p = field.x, field.u, field.p

    @cache
    def of_plant() -> RightHandSide:
        return right_hand_side(field.derivatives(field.driven_by(field.d)), [], x, field.d, u)

    @cache
    def of_observer() -> RightHandSide:
        return right_hand_side(field.derivatives(lumped), field.outputs, x, lumped, u)

    def plant_trial() -> Function:
        arguments = (*_arrays("_x", "_u", "_d", "_k"), _number(SUBSTEP))
        return Function("plant_trial", arguments, _plant_trial(of_plant(), u, p))

    def observer_step() -> Function:
        arguments = (
            *_arrays("_xi", "_inputs", "_squares", "_k"),
            Argument("_gain", "ConvergedGain"),
            _number(H),
        )
        return Function("observer_step", arguments, _observer_step(of_observer(), u, p, ranges))

    return {
        "plant_constants": lambda: _constants("plant_constants", of_plant(), p),
        "plant_trial": plant_trial,
        "observer_constants": lambda: _constants("observer_constants", of_observer(), p),
        "observer_step": observer_step,
    }


def _arrays(*names: str) -> tuple[Argument, ...]:
    return tuple(map(Argument, names))


def _number(symbol: sympy.Symbol) -> Argument:
    return Argument(symbol.name, "number")


def _kept_of_parameters(rhs: RightHandSide, p: Symbols) -> list[tuple[sympy.Symbol, sympy.Expr]]:
    """Return what a step needs of the parameters: names and values."""
    within = [value for _, value in (*rhs.held, *rhs.varying)] + [*rhs.derivatives, *rhs.outputs]
    used = set().union(*(value.free_symbols for value in within))
    return [*rhs.constants, *((symbol, symbol) for symbol in p if symbol in used)]


def _constants(name: str, rhs: RightHandSide, p: Symbols) -> Function:
    """Return the function that computes from the parameters what the step takes as `_k`."""
    values = [value for _, value in _kept_of_parameters(rhs, p)]
    found, reduced = shared(values, "t")
    return Function(
        name, _arrays("_p"), (*element_of_each(p, "_p", values), *assignments(found), Return(tuple(reduced)))
    )


def _unpacked_constants(rhs: RightHandSide, p: Symbols) -> tuple[Statement, ...]:
    return _unpacked([symbol for symbol, _ in _kept_of_parameters(rhs, p)], "_k")


def _unpacked(names: Symbols, array: str) -> tuple[Statement, ...]:
    return (Unpack(tuple(names), array),) if names else ()


def _plant_trial(rhs: RightHandSide, u: Symbols, p: Symbols) -> tuple[Statement, ...]:
    """Try a substep h: x after it and the norm of its error. _d holds d at the nodes."""
    stages = _rows(symbols("d", len(NODES) * len(rhs.d)), len(rhs.d))
    tried = substep(rhs, SUBSTEP, stages)
    return (
        *_unpacked_constants(rhs, p),
        *_unpacked(rhs.x, "_x"),
        *_unpacked(u, "_u"),
        *_unpacked([symbol for stage in stages for symbol in stage], "_d"),
        *assignments(rhs.held),
        *assignments(tried.assignments),
        *assignments(tried.errors),
        *_error_norm(tried),
        Return(Record("Trial", (("x", tried.x_after), ("error_norm", NORM)))),
    )


def _error_norm(tried: SubstepAssignments) -> tuple[Statement, ...]:
    ratios = tuple(sympy.Abs(error) / tolerance for error, tolerance in tried.judged)
    return (*assignments(tried.tolerances), Call((NORM,), "largest", (ratios,)))


def _observer_step(rhs: RightHandSide, u: Symbols, p: Symbols, ranges: Ranges) -> tuple[Statement, ...]:
    """Correct by a sample inside the gate with the converged gain, then predict to the end of the step."""
    outputs, q = len(rhs.outputs), len(rhs.d)
    delta = symbols("q", HIGHEST_ORDER * q)
    gate, weight, squares, d_std, at_std, residual_std, gain, y = (
        symbols("z", outputs),
        symbols("weight", outputs),
        symbols("square", outputs),
        symbols("s", q),
        symbols("at_std", q),
        symbols("v", outputs),
        symbols("K", (len(rhs.x) + len(delta)) * outputs),
        symbols("y", outputs),
    )
    update = correction(rhs, delta, y, _rows(gain, outputs))
    e = tuple(symbol for symbol, _ in update.innovations)
    # Names of their own, because a square would be printed as a power, which costs as much as a sine.
    weighted = symbols("n", outputs)
    d_1, d_at = delta[:q], symbols("o", q)
    prediction, at_end = _prediction(rhs, delta, ranges)
    # A sample that inputs are fed through to needs what is computed of them.
    held = assignments(rhs.held)
    early = held if any(name in output.free_symbols for name, _ in rhs.held for output in rhs.outputs) else ()
    x_hat, d_hat = ([at_end[symbol] for symbol in symbols_of] for symbols_of in (rhs.x, d_1))
    inside_gate = All(tuple(Within(-most, error, most) for error, most in zip(e, gate, strict=True)))
    return (
        *_unpacked_constants(rhs, p),
        *_unpacked([*rhs.x, *delta], "_xi"),
        *_unpacked([*u, *y], "_inputs"),
        Unpack(squares, "_squares"),
        Unpack(gate, "_gain", "gate"),
        Unpack(weight, "_gain", "weight"),
        Unpack(d_std, "_gain", "d_std"),
        Unpack(at_std, "_gain", "at_sample_std"),
        Unpack(residual_std, "_gain", "residual_std"),
        Unpack(gain, "_gain", "K"),
        *early,
        *assignments(update.innovations),
        If(Not(inside_gate), (Fail(),)),
        *(If(Not(Within(-LARGEST, symbol, LARGEST)), (Fail(),)) for symbol in u if symbol.name not in ranges),
        *_within_ranges(u, u, ranges),
        *assignments(zip(weighted, (error * share for error, share in zip(e, weight, strict=True)), strict=True)),
        *assignments(
            (average, average + sympy.Float(1.0 / MEMORY) * (error * one - average))
            for average, error, one in zip(squares, e, weighted, strict=True)
        ),
        *assignments(update.corrected),
        Keep("_at", (*rhs.x, *delta)),
        *assignments(zip(d_at, d_1, strict=True)),
        *(() if early else held),
        *prediction,
        Return(
            Record(
                "ObserverStep",
                (
                    ("xi_hat", (*x_hat, *(at_end.get(symbol, symbol) for symbol in delta))),
                    ("xi_at_sample", Kept("_at")),
                    ("d_hat", tuple(d_hat)),
                    ("innovation", e),
                    ("u", tuple(u)),
                    ("sample", tuple(y)),
                    ("squares", tuple(squares)),
                    (
                        "outputs",
                        (
                            *(*x_hat, *d_hat, *d_at, *d_std, *d_at, *at_std, *e, *residual_std, sympy.true),
                            sympy.Add(*squares) * sympy.Float(1.0 / outputs),
                        ),
                    ),
                ),
            )
        ),
    )


def _prediction(
    rhs: RightHandSide, delta: Symbols, ranges: Ranges
) -> tuple[tuple[Statement, ...], dict[sympy.Symbol, sympy.Expr]]:
    """Integrate x over H by substeps; d is continued by its Taylor series, from substep to substep.

    Returned are the statements, and after these the value at the end of every symbol that changes.
    """
    q = len(rhs.d)
    d_1, d_2, d_3 = _rows(delta, q)
    stages = _rows(symbols("d", len(NODES) * q), q)
    tried = substep(rhs, SUBSTEP, [d_1, *stages[1:]])
    time, left, trials, planned = (sympy.Symbol(f"_{name}", real=True) for name in ("t", "left", "trials", "planned"))
    after = {
        **dict(zip(rhs.x, tried.x_after, strict=True)),
        **dict(zip(d_1, stages[NODES.index(1.0)], strict=True)),
        **{symbol: symbol + SUBSTEP * change for symbol, change in zip(d_2, d_3, strict=True)},
    }
    is_last = Compare(SUBSTEP, "==", left)
    # Most errors are below what is tolerated in any state, so that the tolerances need not be known; and where they
    # are, nothing has left the finite numbers.
    tolerance = sympy.Float(ABSOLUTE_TOLERANCE)
    errors_are_small = tuple(Within(-tolerance, error, tolerance) for error, _ in tried.judged)
    statements = (
        Assign(time, sympy.Float(0.0)),
        Assign(left, H),
        Assign(SUBSTEP, left),
        Assign(trials, sympy.S.One),
        Loop(
            (
                *_taylor_series(stages, d_1, d_2, d_3),
                *assignments(tried.assignments),
                *(check for x in tried.x_at_stages for check in _within_ranges(rhs.x, x, ranges)),
                *assignments(tried.errors),
                If(All((is_last, *errors_are_small)), (Break(),)),
                *_error_norm(tried),
                If(
                    Compare(NORM, "<=", sympy.Float(1.0)),
                    (
                        If(is_last, (If(Not(SumIsFinite(tried.x_after)), (Fail(),)), Break())),
                        *assignments(after.items()),
                    ),
                ),
                Call((time, SUBSTEP, left, trials, planned), "next_substep", (time, SUBSTEP, trials, NORM, H)),
                If(Compare(trials, "==", sympy.S.Zero), (Fail(),)),
            )
        ),
    )
    return statements, after


def _within_ranges(names: Symbols, values: Sequence[sympy.Expr], ranges: Ranges) -> tuple[Statement, ...]:
    """Fail where a value leaves the range of its name."""
    return tuple(
        If(Not(Within(sympy.Float(low), value, sympy.Float(high))), (Fail(),))
        for name, value in zip(names, values, strict=True)
        if name.name in ranges
        for low, high in [ranges[name.name]]
    )


def _taylor_series(stages: Sequence[Symbols], d_1: Symbols, d_2: Symbols, d_3: Symbols) -> tuple[Statement, ...]:
    """Compute d at the nodes of a substep from its derivatives; up to the order r = 2 the second one is 0."""
    q = len(d_1)
    rise, bend, half = symbols("a", q), symbols("b", q), sympy.Symbol("_half", real=True)

    def at_nodes(*terms: Symbols) -> tuple[Statement, ...]:
        return assignments(
            (stage[j], d_1[j] + sum(_power(node, i) * term[j] for i, term in enumerate(terms, 1)))
            for node, stage in zip(NODES, stages, strict=True)
            for j in range(q)
            if node
        )

    return (
        *assignments((name, SUBSTEP * value) for name, value in zip(rise, d_2, strict=True)),
        If(
            AnyNonzero(tuple(d_3)),
            (
                Assign(half, sympy.Float(0.5) * SUBSTEP),
                *assignments((name, half * SUBSTEP * value) for name, value in zip(bend, d_3, strict=True)),
                *at_nodes(rise, bend),
            ),
            at_nodes(rise),
        ),
    )


def _power(node: float, exponent: int) -> sympy.Expr:
    return sympy.S.One if node == 1.0 else sympy.Float(node**exponent)


def _rows(entries: Symbols, columns: int) -> list[Symbols]:
    return [entries[i : i + columns] for i in range(0, len(entries), columns)]
