"""Start values in the FMI type of their variable, from what people and files write, and numbers of descriptions."""

from __future__ import annotations

import math
from typing import Any

from ndob_fmu.cosim.component import Value, Variable
from ndob_fmu.errors import CouplingError, UsageError, one_of

_TRUTH = {"true": True, "1": True, "false": False, "0": False}


def convert(variable: Variable, value: Any, where: str) -> Value:
    """Return ``value`` (a number, a bool or its text) in the type of ``variable``; raise UsageError if it has none."""
    text = str(value).strip()
    try:
        if variable.type == "Real":
            return float(value)
        if variable.type == "Boolean":
            return _TRUTH[text.lower()] if isinstance(value, str) else _TRUTH[str(int(value))]
        if variable.type == "String":
            return str(value)
        if text in dict(variable.items):
            return dict(variable.items)[text]
        number = float(value)
        if number.is_integer():
            return int(number)
    except (KeyError, TypeError, ValueError, OverflowError):
        pass
    wanted = {"Real": "a number", "Boolean": "true, false, 1 or 0"}.get(variable.type, "a whole number")
    if variable.items:
        wanted = one_of("item", (f"{name} = {number}" for name, number in variable.items), text)
    raise UsageError.report(where, expected=f"{wanted} ({variable.type})", received=repr(text))


def finite_number(where: str, text: str | None, expected: str = "a finite number") -> float | None:
    """Return the number that a description gives, None where it gives none; raise CouplingError if it is not finite."""
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CouplingError.report(where, expected=expected, received=repr(text))
    return value
