"""Trees of statements and SymPy's expressions as Python text, which evaluates to exactly the model's numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import sympy
from sympy.printing.pycode import PythonCodePrinter

from ndob_fmu.codegen.program import (
    All,
    AnyNonzero,
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
from ndob_fmu.errors import ModelError

# What the text of `print_function` uses. No name of a model begins with an underscore, so that no name hides these.
IMPORTS = """import math

from ndob_fmu.runtime.generated_steps import ObserverStep as _ObserverStep
from ndob_fmu.runtime.generated_steps import Trial as _Trial
from ndob_fmu.runtime.numerics.integrate import largest as _largest
from ndob_fmu.runtime.numerics.integrate import next_substep as _next_substep

_new = tuple.__new__  # takes half the time of the named tuple's own
"""


class _Printer(PythonCodePrinter):  # type: ignore[misc]
    """SymPy's printer, changed so that every float keeps all its digits; SymPy's own keeps 15.

    The model's names get an underscore behind them; names of the generated text begin with one.
    """

    def _print_Symbol(self, symbol: sympy.Symbol) -> str:
        return self.name(symbol)

    @staticmethod
    def name(symbol: sympy.Symbol) -> str:
        # Names of Python do not end like this, so that a state `id` or `abs` hides nothing that the text uses.
        return str(symbol.name if symbol.name.startswith("_") else f"{symbol.name}_")

    def _print_Float(self, number: sympy.Float) -> str:
        return repr(float(number))

    def _print_Pow(self, power: sympy.Pow, rational: bool = False) -> str:
        # A root of a negative number is an error, not the complex number that ** makes of it.
        if not power.exp.is_Integer and abs(power.exp) != sympy.Rational(1, 2):
            return f"math.pow({self._print(power.base)}, {self._print(power.exp)})"
        text: str = super()._print_Pow(power, rational=rational)
        return text

    def _print_Piecewise(self, pieces: sympy.Piecewise) -> str:
        if pieces.args[-1].cond != sympy.true:  # where no condition holds there is no number; SymPy would write None
            pieces = sympy.Piecewise(*pieces.args, (sympy.nan, True))
        text: str = super()._print_Piecewise(pieces)
        return text


_PRINTER = _Printer({"fully_qualified_modules": True})


def _expression(expression: sympy.Expr) -> str:
    """Return the expression in Python. Raises ModelError for a function that has no Python form."""
    if isinstance(expression, sympy.Symbol):  # half of all expressions; SymPy prepares more than it prints
        return _PRINTER.name(expression)
    try:
        text: str = _PRINTER.doprint(expression)
    except NotImplementedError as error:
        raise ModelError.report(
            "f", expected="functions with a Python form", received=str(expression), likely="an undefined function"
        ) from error
    return text


def has_python_form(expression: sympy.Expr) -> bool:
    """Return whether the expression can be printed."""
    try:
        _PRINTER.doprint(expression)
    except NotImplementedError:
        return False
    return True


def print_function(function: Function) -> str:
    """Return the function in Python. Raises ModelError for a function that has no Python form."""
    return (
        "\n".join(
            [
                f"def {function.name}({', '.join(argument.name for argument in function.arguments)}):",
                *_indented(function.body),
            ]
        )
        + "\n"
    )


def _indented(body: Iterable[Statement]) -> Iterator[str]:
    for statement in body:
        yield from (f"    {line}" for line in _lines(statement))


def _lines(statement: Statement) -> Iterator[str]:
    match statement:
        case Assign(target, value):
            yield f"{_expression(target)} = {_expression(value)}"
        case Element(target, array, index):
            yield f"{_expression(target)} = {array}[{index}]"
        case Unpack(names, argument, field):
            yield f"{_value(names)} = {argument}{f'.{field}' if field else ''}"
        case Keep(name, values):
            yield f"{name} = {_value(values)}"
        case Call(targets, function, arguments):
            yield f"{', '.join(map(_expression, targets))} = _{function}({', '.join(map(_value, arguments))})"
        case If(condition, then, otherwise):
            yield f"if {_condition(condition)}:"
            yield from _indented(then)
            if otherwise:
                yield "else:"
                yield from _indented(otherwise)
        case Loop(body):
            yield "while True:"
            yield from _indented(body)
        case Break():
            yield "break"
        case Fail():
            yield "return None"
        case Return(value):
            yield from f"return {_result(value)}".splitlines()


def _condition(condition: Condition) -> str:
    match condition:
        case Within(low, value, high):
            return f"{_expression(low)} <= {_expression(value)} <= {_expression(high)}"
        case Compare(left, relation, right):
            return f"{_expression(left)} {relation} {_expression(right)}"
        case SumIsFinite(values):
            return f"math.isfinite({' + '.join(map(_expression, values))})"
        case AnyNonzero(values):
            return " or ".join(map(_expression, values))
        case All(conditions):
            return " and ".join(map(_condition, conditions))
        case Not(inner):
            text = _condition(inner)
            return f"not ({text})" if isinstance(inner, All) else f"not {text}"


def _result(value: Value) -> str:
    """Return a value as `_value` does, but several matrices one below the other."""
    if not (isinstance(value, tuple) and value and isinstance(value[0], tuple)):
        return _value(value)
    return "(\n" + "".join(f"    {_value(matrix)},\n" for matrix in value) + ")"


def _value(value: Value) -> str:
    if isinstance(value, tuple):
        return _tuple(map(_value, value))
    if isinstance(value, Kept):
        return value.name
    if isinstance(value, Record):
        return f"_new(_{value.type}, {_tuple(_value(field) for _, field in value.fields)})"
    return _expression(value)


def _tuple(items: Iterable[str]) -> str:
    items = list(items)
    return f"({', '.join(items)}{',' if len(items) == 1 else ''})"
