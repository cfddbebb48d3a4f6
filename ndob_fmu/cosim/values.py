"""Start values as people and files write them, turned into what the variable's FMI type takes."""

from __future__ import annotations

from typing import Any

from ndob_fmu.cosim.component import Value, Variable
from ndob_fmu.errors import UsageError, one_of

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
