"""Values of translated expressions, and how names and constants are written in C."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndob_fmu.native.translate.kinds import BOOL, INT, Kind

_RESERVED = {"auto", "break", "case", "char", "const", "default", "do", "double", "enum", "extern", "float", "goto"}
_RESERVED |= {"inline", "int", "long", "register", "short", "signed", "sizeof", "static", "struct", "switch", "union"}
_RESERVED |= {"typedef", "unsigned", "void", "volatile", "arena", "nd", "env", "bool", "true", "false", "exp", "log"}


@dataclass(frozen=True)
class Value:
    """An expression in C.

    fresh: whether its array belongs to this function alone
    parts: of an item of several iterations at once, which only a tuple of names takes apart
    """

    text: str
    kind: Kind
    fresh: bool = False
    parts: tuple[Value, ...] = ()


def in_parentheses(condition: str) -> str:
    """Return a condition in one pair of parentheses; of two around a comparison, clang warns."""
    depth, first_ends = 0, -1
    for place, character in enumerate(condition):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            first_ends = place
            break
    is_whole = condition.startswith("(") and first_ends == len(condition) - 1
    return condition if is_whole else f"({condition})"


def c_name(name: str) -> str:
    """Return the name of a variable in C."""
    return f"{name}_" if name in _RESERVED or name.startswith("_") else name


def number_text(value: float) -> str:
    """Return a constant with all its digits."""
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return repr(float(value)) if value >= 0 and not np.signbit(value) else f"({float(value)!r})"


def entry(text: str, kind: Kind) -> Value:
    """Return an entry of an array, which is stored as float, as a number of its type."""
    return Value(f"(int){text}" if kind == INT else f"({text} != 0.0)" if kind == BOOL else text, kind)
