"""A small printer of the generated functions in C: what a second back end has to write, and no more."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import sympy
from sympy.printing.c import C99CodePrinter

from ndob_fmu.codegen import program as tree

# What the generated steps call, as `runtime.numerics.integrate` has it.
RUNTIME = """
#include <math.h>
#include <stddef.h>

static double largest(const double *ratios, size_t count) {
    double sum = 0.0, most = 0.0;
    for (size_t i = 0; i < count; i++) { sum += ratios[i]; most = fmax(most, ratios[i]); }
    return isfinite(sum) ? most : INFINITY;
}

static double length_after(double length, double norm) {
    double grow = norm > 0.0 ? fmin(5.0, fmax(0.2, 0.9 * pow(norm, -0.2))) : 5.0;
    return length * (norm > 1.0 ? fmin(grow, 0.9) : grow);
}

static void next_substep(double *t, double *length, double *left, double *trials, double *planned,
                         double begin, double tried, double count, double norm, double t_end) {
    *t = norm <= 1.0 ? begin + tried : begin;
    *left = t_end - *t;
    *planned = length_after(tried, norm);
    *length = *planned >= *left * (1.0 - 1e-12) ? *left : *planned;
    int too_many = count >= 100000 || (count == 10000 && *left > 100000 * *planned)
        || (count >= 30 && *left * count > 500 * *t && *left > 500 * *planned);
    *trials = too_many || !isfinite(norm) ? 0 : count + 1;
}
"""


class _Expressions(C99CodePrinter):
    def _print_Symbol(self, symbol):
        return symbol.name if symbol.name.startswith("_") else f"{symbol.name}_"

    def _print_Float(self, number):
        return repr(float(number))

    def _print_BooleanTrue(self, _):
        return "1.0"


_EXPRESSIONS = _Expressions()


def print_function(function: tree.Function) -> str:
    """Return a C function that writes its result to `_result` and returns 1, or returns 0 where it fails.

    Structures consist of arrays of numbers only, and are passed as one array after the other.
    """
    lines = []
    fields = [s for s in statements(function.body) if isinstance(s, tree.Unpack) and s.field]
    types = {"number": "double ", "array": "const double *"}
    for argument in function.arguments:
        if argument.type not in types:
            own = " ".join(f"double {s.field}[{len(s.names)}];" for s in fields if s.argument == argument.name)
            lines.append(f"struct {argument.type} {{ {own} }};")
    arguments = [
        types.get(argument.type, f"const struct {argument.type} *") + argument.name for argument in function.arguments
    ]
    lines.append(f"int {function.name}({', '.join([*arguments, 'double *_result'])}) {{")
    kept = {s.name: len(s.values) for s in statements(function.body) if isinstance(s, tree.Keep)}
    own = sorted(
        {_text(name) for s in statements(function.body) for name in _targets(s)}
        - {argument.name for argument in function.arguments}
    )
    lines += [f"double {name} = 0.0;" for name in own]
    lines += [f"double {name}[{count}];" for name, count in kept.items()]
    for statement in function.body:
        lines += _lines(statement, kept)
    return "\n".join([*lines, "}"])


def statements(body: Iterable[tree.Statement]) -> Iterator[tree.Statement]:
    """Return all statements, those inside branches and loops too."""
    for statement in body:
        yield statement
        if isinstance(statement, tree.If):
            yield from statements((*statement.then, *statement.otherwise))
        elif isinstance(statement, tree.Loop):
            yield from statements(statement.body)


def _targets(statement: tree.Statement) -> tuple[sympy.Symbol, ...]:
    match statement:
        case tree.Assign(target, _) | tree.Element(target, _, _):
            return (target,)
        case tree.Unpack(names, _, _) | tree.Call(names, _, _):
            return names
    return ()


def _lines(statement: tree.Statement, kept: dict[str, int]) -> Iterator[str]:
    match statement:
        case tree.Assign(target, value):
            yield f"{_text(target)} = {_text(value)};"
        case tree.Element(target, array, index):
            yield f"{_text(target)} = {array}[{index}];"
        case tree.Unpack(names, argument, field):
            array = f"{argument}->{field}" if field else argument
            yield from (f"{_text(name)} = {array}[{index}];" for index, name in enumerate(names))
        case tree.Keep(name, values):
            yield from (f"{name}[{index}] = {_text(value)};" for index, value in enumerate(values))
        case tree.Call((target,), function, (tuple() as values,)):
            elements = ", ".join(map(_text, values))
            yield f"{_text(target)} = {function}((double[]){{{elements}}}, {len(values)});"
        case tree.Call(targets, function, arguments):
            yield f"{function}({', '.join([*(f'&{_text(t)}' for t in targets), *map(_text, arguments)])});"
        case tree.If(condition, then, otherwise):
            yield f"if ({_condition(condition)}) {{"
            yield from (line for inner in then for line in _lines(inner, kept))
            yield "} else {"
            yield from (line for inner in otherwise for line in _lines(inner, kept))
            yield "}"
        case tree.Loop(body):
            yield "for (;;) {"
            yield from (line for inner in body for line in _lines(inner, kept))
            yield "}"
        case tree.Break():
            yield "break;"
        case tree.Fail():
            yield "return 0;"
        case tree.Return(value):
            yield from (f"_result[{index}] = {number};" for index, number in enumerate(_numbers(value, kept)))
            yield "return 1;"
        case _:
            raise TypeError(statement)


def _condition(condition: tree.Condition) -> str:
    match condition:
        case tree.Within(low, value, high):
            return f"({_text(low)} <= {_text(value)} && {_text(value)} <= {_text(high)})"
        case tree.Compare(left, relation, right):
            return f"({_text(left)} {relation} {_text(right)})"
        case tree.SumIsFinite(values):
            return f"isfinite({' + '.join(map(_text, values))})"
        case tree.AnyNonzero(values):
            return "(" + " || ".join(f"{_text(value)} != 0.0" for value in values) + ")"
        case tree.All(conditions):
            return "(" + " && ".join(map(_condition, conditions)) + ")"
        case tree.Not(inner):
            return f"!{_condition(inner)}"
    raise TypeError(condition)


def _numbers(value: tree.Value, kept: dict[str, int]) -> list[str]:
    if isinstance(value, tree.Record):
        return [number for _, field in value.fields for number in _numbers(field, kept)]
    if isinstance(value, tree.Kept):
        return [f"{value.name}[{index}]" for index in range(kept[value.name])]
    if isinstance(value, tuple):
        return [number for element in value for number in _numbers(element, kept)]
    return [_text(value)]


def _text(value: sympy.Basic) -> str:
    return str(_EXPRESSIONS.doprint(value))
