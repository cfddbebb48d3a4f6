"""Trees of statements as C text, which evaluates to the bits of the Python text.

Each function is `static int name(arguments, double *_result)`. Arrays are `const double *`; of a structure each field
that is used is an argument of its own, `_structure_field`. A result is one array after the other, however nested.
Where Python raises an exception or returns None, the C function returns one of the faults of `RUNTIME` in
`c_expressions`, and its result is undefined.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping

import sympy

from ndob_fmu.codegen.c_expressions import c_expression
from ndob_fmu.codegen.program import (
    All,
    AnyNonzero,
    Argument,
    Assign,
    Break,
    Call,
    Compare,
    Condition,
    Element,
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
    Value,
    Within,
)


def print_function(function: Function) -> str:
    """Return the function in C. Raises ModelError for a function that has no C form."""
    arguments = [text for argument in function.arguments for text in _declared(argument, function)]
    own = _names(function.body) - {argument.name for argument in function.arguments}
    kept = {s.name: len(s.values) for s in statements(function.body) if isinstance(s, Keep)}
    body = [line for statement in function.body for line in _lines(statement, kept)]
    names = [argument.name for argument in function.arguments if argument.type in ("number", "array")] + ["_result"]
    lines = [
        "int _fault = 0;",
        *(f"double {name} = 0.0;" for name in sorted(own)),
        *(f"double {name}[{count or 1}];" for name, count in kept.items()),
        *(f"(void){name};" for name in _unread([*names, *sorted(own)], body)),
        *body,
    ]
    head = f"static int {function.name}({', '.join([*arguments, 'double *_result'])}) {{"
    return "\n".join([head, *(f"    {line}" for line in lines), "}"]) + "\n"


def statements(body: Iterable[Statement]) -> Iterator[Statement]:
    """Return all statements, those inside branches and loops too."""
    for statement in body:
        yield statement
        if isinstance(statement, If):
            yield from statements((*statement.then, *statement.otherwise))
        elif isinstance(statement, Loop):
            yield from statements(statement.body)


def _declared(argument: Argument, function: Function) -> list[str]:
    if argument.type == "number":
        return [f"double {argument.name}"]
    if argument.type == "array":
        return [f"const double *{argument.name}"]
    used = [s for s in statements(function.body) if isinstance(s, Unpack) and s.argument == argument.name]
    return [f"const double *{argument.name}_{s.field}" for s in used]


def _unread(names: Iterable[str], body: Iterable[str]) -> list[str]:
    """Return the names that no line reads, which compilers warn of."""
    text = "\n".join(body)
    read = set(re.findall(r"\w+", re.sub(r"(?m)^ *\w+ = ", "", text)))
    return [name for name in names if name not in read]


def _names(body: Iterable[Statement]) -> set[str]:
    """Return the names that the statements assign to."""
    targets: set[sympy.Symbol] = set()
    for statement in statements(body):
        match statement:
            case Assign(target, _) | Element(target, _, _):
                targets.add(target)
            case Unpack(names, _, _) | Call(names, _, _):
                targets.update(names)
    return {c_expression(target) for target in targets}


def _lines(statement: Statement, kept: Mapping[str, int]) -> Iterator[str]:
    match statement:
        case Assign(target, value):
            yield f"{c_expression(target)} = {c_expression(value)};"
        case Element(target, array, index):
            yield f"{c_expression(target)} = {array}[{index}];"
        case Unpack(names, argument, field):
            array = f"{argument}_{field}" if field else argument
            yield from (f"{c_expression(name)} = {array}[{index}];" for index, name in enumerate(names))
        case Keep(name, values):
            yield from (f"{name}[{index}] = {c_expression(value)};" for index, value in enumerate(values))
        case Call((target,), function, (tuple() as values,)):
            elements = ", ".join(c_expression(value) for value in values)
            yield f"{c_expression(target)} = {function}((const double[]){{{elements}}}, {len(values)});"
        case Call(targets, function, arguments):
            results = [f"&{c_expression(target)}" for target in targets]
            yield f"{function}({', '.join([*map(c_expression, arguments), *results])});"
        case If(condition, then, otherwise):
            yield f"if ({_condition(condition)}) {{"
            yield from (f"    {line}" for inner in then for line in _lines(inner, kept))
            if otherwise:
                yield "} else {"
                yield from (f"    {line}" for inner in otherwise for line in _lines(inner, kept))
            yield "}"
        case Loop(body):
            yield "for (;;) {"
            yield "    if (_fault) return _fault;"
            yield from (f"    {line}" for inner in body for line in _lines(inner, kept))
            yield "}"
        case Break():
            yield "break;"
        case Fail():
            yield "return _fault ? _fault : STOPPED;"
        case Return(value):
            yield from (f"_result[{index}] = {number};" for index, number in enumerate(_numbers(value, kept)))
            yield "return _fault;"


def _condition(condition: Condition) -> str:
    match condition:
        case Within(low, value, high):
            return f"{c_expression(low)} <= {c_expression(value)} && {c_expression(value)} <= {c_expression(high)}"
        case Compare(left, relation, right):
            return f"{c_expression(left)} {relation} {c_expression(right)}"
        case SumIsFinite(values):
            return f"finite_number({' + '.join(map(c_expression, values))})"
        case AnyNonzero(values):
            return " || ".join(f"{c_expression(value)} != 0.0" for value in values) or "0"
        case All(conditions):
            return " && ".join(f"({_condition(each)})" for each in conditions) or "1"
        case Not(inner):
            return f"!({_condition(inner)})"


def _numbers(value: Value, kept: Mapping[str, int]) -> list[str]:
    """Return the numbers of a result in their order."""
    if isinstance(value, Record):
        return [number for _, field in value.fields for number in _numbers(field, kept)]
    if isinstance(value, Kept):
        return [f"{value.name}[{index}]" for index in range(kept[value.name])]
    if isinstance(value, tuple):
        return [number for element in value for number in _numbers(element, kept)]
    return [c_expression(value)]
