"""Write the steps of plant and observer as Python functions on scalars, around the assignments of `straight_line`.

They do what `runtime.plant` and `runtime.sampled_observer` define with NumPy, and take the same decisions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from sys import float_info

import sympy

from ndob_fmu.codegen.python_text import python_text, tuple_text
from ndob_fmu.codegen.straight_line import RightHandSide, correction, right_hand_side, symbols, trial
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.equations import HIGHEST_ORDER
from ndob_fmu.runtime.numerics.integrate import ABSOLUTE_TOLERANCE, NODES

# Names of the model do not begin with an underscore, so that none can hide these.
STEP_IMPORTS = """from ndob_fmu.runtime.numerics.integrate import ALMOST as _ALMOST
from ndob_fmu.runtime.numerics.integrate import needs_too_many as _needs_too_many
from ndob_fmu.runtime.numerics.integrate import largest as _largest
from ndob_fmu.runtime.numerics.integrate import next_substep as _next_substep
"""

Symbols = Sequence[sympy.Symbol]


def emit_steps(model: Model) -> list[str]:
    """Return the texts of plant_constants, plant_step, observer_constants and observer_step.

    Raises ModelError where an expression has no Python form.
    """
    x, u, d, p = (
        [model.symbols[name] for name in group]
        for group in (model.states, model.inputs, model.disturbances, model.parameters)
    )
    known = model.A * sympy.Matrix(x)
    if u:
        known += model.B * sympy.Matrix(u)
    if model.f_expressions:
        known += model.G_f * sympy.Matrix(len(model.f_expressions), 1, list(model.f_expressions))
    # To the plant n(x, u) d is a function of x; the observer estimates it as inputs of their own.
    driving = [direction * d[0] for direction in model.channel_expressions] or d
    lumped = symbols("w", len(driving))
    of_plant = right_hand_side(list(known + model.G_d * sympy.Matrix(driving)), [], x, d, u)
    outputs = list(model.C * sympy.Matrix(x))
    of_observer = right_hand_side(list(known + model.G_d * sympy.Matrix(lumped)), outputs, x, lumped, u)
    return [
        *_functions("plant", of_plant, p, "_x, _u, _d, _k, _h", _plant_step(of_plant, u)),
        *_functions("observer", of_observer, p, "_xi, _inputs, _k, _r, _H", _observer_step(of_observer, u)),
    ]


def _functions(part: str, rhs: RightHandSide, p: Symbols, arguments: str, step: list[str]) -> tuple[str, str]:
    """Return the function that makes _k, what the step needs of the parameters, and the step."""
    within = [value for _, value in (*rhs.held, *rhs.varying)] + [*rhs.derivatives, *rhs.outputs]
    used = set().union(*(value.free_symbols for value in within))
    constants = [*rhs.constants, *((symbol, symbol) for symbol in p if symbol in used)]
    temporaries = sympy.numbered_symbols("_t", real=True)
    values = [value for _, value in constants]
    shared, values = sympy.cse(values, symbols=temporaries, list=True) if values else ([], [])
    needed = set().union(*(value.free_symbols for _, value in constants))
    of_parameters = [
        *(f"{python_text(symbol)} = _p[{i}]" for i, symbol in enumerate(p) if symbol in needed),
        *_assigned(shared),
        f"return {tuple_text(map(python_text, values))}",
    ]
    return (
        _function(f"{part}_constants", "_p", of_parameters),
        _function(f"{part}_step", arguments, [*_unpacked([symbol for symbol, _ in constants], "_k"), *step]),
    )


def _plant_step(rhs: RightHandSide, u: Symbols) -> list[str]:
    """Return the trial of a substep h: x after it and the norm of its error. _d holds d at the nodes."""
    stages = _rows(symbols("d", len(NODES) * len(rhs.d)), len(rhs.d))
    tried = trial(rhs, sympy.Symbol("_h", real=True), stages)
    return [
        *_unpacked(rhs.x, "_x"),
        *_unpacked(u, "_u"),
        *_unpacked([symbol for stage in stages for symbol in stage], "_d"),
        *_assigned(rhs.held),
        *_assigned(tried.assignments),
        *_assigned(tried.errors),
        *_assigned(tried.tolerances),
        f"return {_values(tried.x_after)}, {_error_norm(tried.judged)}",
    ]


def _observer_step(rhs: RightHandSide, u: Symbols) -> list[str]:
    """Return the step from a usual sample with the gain at rest, as `Steps` has it."""
    p, q = len(rhs.outputs), len(rhs.d)
    delta = symbols("q", HIGHEST_ORDER * q)
    d_std, residual_std, usual, gain, y = (
        symbols("s", q),
        symbols("v", p),
        symbols("z", p),
        symbols("K", (len(rhs.x) + len(delta)) * p),
        symbols("y", p),
    )
    update = correction(rhs, delta, y, _rows(gain, p))
    e = [symbol for symbol, _ in update.residuals]

    # d̂ is continued by its Taylor series, from substep to substep.
    d_1, d_2, d_3 = _rows(delta, q)
    h, d_at, rise, bend = sympy.Symbol("_h", real=True), symbols("o", q), symbols("a", q), symbols("b", q)
    stages = _rows(symbols("d", len(NODES) * q), q)
    rising, bending = (
        [
            (stage[j], d_1[j] + sum(_power(node, i) * term[j] for i, term in enumerate(terms, 1)))
            for node, stage in zip(NODES, stages, strict=True)
            for j in range(q)
            if node
        ]
        for terms in ((rise,), (rise, bend))
    )
    tried = trial(rhs, h, [d_1, *stages[1:]])
    moved = [
        *zip(rhs.x, tried.x_after, strict=True),
        *zip(d_1, stages[NODES.index(1.0)], strict=True),
        *((symbol, symbol + h * change) for symbol, change in zip(d_2, d_3, strict=True)),
    ]
    # Most errors are below what is tolerated in any state, so that the tolerances need not be known; and where they
    # are, nothing has left the finite numbers.
    usually = " and ".join(f"-{ABSOLUTE_TOLERANCE!r} <= {error} <= {ABSOLUTE_TOLERANCE!r}" for error, _ in tried.judged)
    return [
        *_unpacked([*rhs.x, *delta], "_xi"),
        *_unpacked([*u, *y], "_inputs"),
        *_unpacked([*usual, *d_std, *residual_std, *gain], "_r"),
        *_assigned(update.residuals),
        f"if not ({' and '.join(f'-{most} <= {error} <= {most}' for error, most in zip(e, usual, strict=True))}):",
        "    return None",
        *(
            line
            for symbol in u
            for line in (
                f"if not {-float_info.max!r} <= {python_text(symbol)} <= {float_info.max!r}:",
                "    return None",
            )
        ),
        *_assigned(update.corrected),
        f"_at = {_values([*rhs.x, *delta])}",
        *_assigned(zip(d_at, d_1, strict=True)),
        *_assigned(rhs.held),
        "_t = 0.0",
        "_h = _left = _H",
        "_trials = 1",
        "while True:",
        *(f"    {name} = _h * {value}" for name, value in zip(rise, d_2, strict=True)),
        f"    if {' or '.join(map(str, d_3))}:",
        *(f"        {name} = 0.5 * _h * _h * {value}" for name, value in zip(bend, d_3, strict=True)),
        *_indented(_indented(_assigned(bending))),
        "    else:",  # as it is up to the order r = 2
        *_indented(_indented(_assigned(rising))),
        *_indented(_assigned(tried.assignments)),
        *_indented(_assigned(tried.errors)),
        f"    if _h == _left and {usually}:",
        "        break",
        *_indented(_assigned(tried.tolerances)),
        f"    _norm = {_error_norm(tried.judged)}",
        "    if _norm <= 1.0:",
        "        if _h == _left:",
        f"            if not math.isfinite({' + '.join(map(python_text, tried.x_after))}):",
        "                return None",
        "            break",
        *_indented(_indented(_assigned(moved))),
        "        _t += _h",
        "    if _norm == math.inf:",
        "        return None",
        "    _h = _next_substep(_h, _norm)",
        "    _left = _H - _t",
        "    if _needs_too_many(_trials, _left, _h):",
        "        return None",
        "    _trials += 1",
        "    if _h >= _left * _ALMOST:",
        "        _h = _left",
        *_assigned(moved),
        f"_outputs = {tuple_text([*map(python_text, [*rhs.x, *d_1, *d_at, *d_std, *e, *residual_std]), 'True'])}",
        f"return {_values([*rhs.x, *delta])}, _outputs, _at, {_values(e)}, {_values(u)}, {_values(d_1)}",
    ]


def _function(name: str, arguments: str, body: Iterable[str]) -> str:
    return "\n".join([f"def {name}({arguments}):", *_indented(body)]) + "\n"


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"    {line}" for line in lines]


def _assigned(assignments: Iterable[tuple[sympy.Symbol, sympy.Expr]]) -> list[str]:
    return [f"{python_text(symbol)} = {python_text(value)}" for symbol, value in assignments if symbol != value]


def _unpacked(names: Symbols, argument: str) -> list[str]:
    return [f"{_values(names)} = {argument}"] if names else []


def _values(expressions: Iterable[sympy.Expr]) -> str:
    return tuple_text(map(python_text, expressions))


def _error_norm(judged: Sequence[tuple[sympy.Symbol, sympy.Symbol]]) -> str:
    return f"_largest({tuple_text(f'abs({error}) / {tolerance}' for error, tolerance in judged)})"


def _power(node: float, exponent: int) -> sympy.Expr:
    return sympy.S.One if node == 1.0 else sympy.Float(node**exponent)


def _rows(entries: Symbols, columns: int) -> list[Symbols]:
    return [entries[i : i + columns] for i in range(0, len(entries), columns)]
