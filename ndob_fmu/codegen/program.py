"""Generated functions as trees of statements, which a printer for any language can write.

SymPy's expressions are the leaves. SymPy has a tree of statements too, `sympy.codegen.ast`. It has no branch
around statements and no results by name, and it simplifies comparisons when they are built.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import sympy

# -- values


@dataclass(frozen=True)
class Kept:
    """The array that a `Keep` stored under a name."""

    name: str


@dataclass(frozen=True)
class Record:
    """Values by name, for the runtime's structure `type`."""

    type: str
    fields: tuple[tuple[str, Value], ...]


# A number, an array (nested: row by row), or a structure.
Value: TypeAlias = "sympy.Expr | sympy.logic.boolalg.Boolean | Kept | Record | tuple[Value, ...]"

# -- conditions


@dataclass(frozen=True)
class Within:
    """low ≤ value ≤ high, which does not hold for NaN."""

    low: sympy.Expr
    value: sympy.Expr
    high: sympy.Expr


@dataclass(frozen=True)
class Compare:
    """left ≤ right or left = right."""

    left: sympy.Expr
    relation: Literal["<=", "=="]
    right: sympy.Expr


@dataclass(frozen=True)
class SumIsFinite:
    """The sum of the values is neither infinite nor NaN."""

    values: tuple[sympy.Expr, ...]


@dataclass(frozen=True)
class AnyNonzero:
    """At least one of the values is not 0."""

    values: tuple[sympy.Expr, ...]


@dataclass(frozen=True)
class All:
    """All of the conditions hold."""

    conditions: tuple[Condition, ...]


@dataclass(frozen=True)
class Not:
    """The condition does not hold."""

    condition: Condition


Condition: TypeAlias = Within | Compare | SumIsFinite | AnyNonzero | All | Not

# -- statements


@dataclass(frozen=True)
class Assign:
    """target = value."""

    target: sympy.Symbol
    value: sympy.Expr


@dataclass(frozen=True)
class Element:
    """target = array[index], where `array` is an argument."""

    target: sympy.Symbol
    array: str
    index: int


@dataclass(frozen=True)
class Unpack:
    """Every name = its element of an array, which is an argument or a field of one, as long as there are names."""

    names: tuple[sympy.Symbol, ...]
    argument: str
    field: str | None = None


@dataclass(frozen=True)
class Keep:
    """Store the present values of an array under a name."""

    name: str
    values: tuple[sympy.Expr, ...]


@dataclass(frozen=True)
class Call:
    """targets = function(arguments): a function of the runtime; with several targets it returns as many numbers.

    An argument that is a tuple is an array.
    """

    targets: tuple[sympy.Symbol, ...]
    function: str
    arguments: tuple[Value, ...]


@dataclass(frozen=True)
class If:
    """The statements `then` where the condition holds, else those of `otherwise`."""

    condition: Condition
    then: tuple[Statement, ...]
    otherwise: tuple[Statement, ...] = ()


@dataclass(frozen=True)
class Loop:
    """The body again and again, until a `Break`, `Fail` or `Return`."""

    body: tuple[Statement, ...]


@dataclass(frozen=True)
class Break:
    """Leave the innermost loop."""


@dataclass(frozen=True)
class Fail:
    """End the function without a result."""


@dataclass(frozen=True)
class Return:
    """End the function with a result."""

    value: Value


Statement: TypeAlias = Assign | Element | Unpack | Keep | Call | If | Loop | Break | Fail | Return

# -- functions


@dataclass(frozen=True)
class Argument:
    """An argument of a function; `type` is "number", "array", or the name of one of the runtime's structures."""

    name: str
    type: str = "array"


@dataclass(frozen=True)
class Function:
    """A function; it does not change its arguments."""

    name: str
    arguments: tuple[Argument, ...]
    body: tuple[Statement, ...]


def assignments(pairs: Iterable[tuple[sympy.Symbol, sympy.Expr]]) -> tuple[Assign, ...]:
    """Return one assignment for each pair of a symbol and a value that differs from it."""
    return tuple(Assign(symbol, value) for symbol, value in pairs if symbol != value)


def element_of_each(symbols: Iterable[sympy.Symbol], array: str, used_in: Iterable[sympy.Expr]) -> tuple[Element, ...]:
    """Return symbol = array[index] for every symbol that occurs in the expressions."""
    used: set[sympy.Basic] = set().union(*(expression.free_symbols for expression in used_in))
    return tuple(Element(symbol, array, index) for index, symbol in enumerate(symbols) if symbol in used)
