"""Start values of the FMUs' parameters that a user gives in place of the model's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ndob_fmu.errors import UsageError, nearest, one_of
from ndob_fmu.interface.variables import Variable, expected_value, is_acceptable

_TRUTH = {"true": True, "1": True, "false": False, "0": False}


def typed_values(variables: Sequence[Variable], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return start values, given as numbers or as text, in the types of the parameters of these names.

    Raises UsageError for a name that is no parameter, and for a value that it cannot have.
    """
    parameters = {v.name: v for v in variables if v.causality == "parameter"}
    for name in given:
        if name not in parameters:
            raise UsageError.report(
                f"start value of {name}",
                expected=one_of("parameter", parameters, name),
                received=repr(name),
                likely=nearest(name, parameters),
            )
    return {name: _typed(parameters[name], value) for name, value in given.items()}


def started(variables: Sequence[Variable], values: Mapping[str, Any]) -> tuple[tuple[Variable, ...], dict[str, Any]]:
    """Return the variables with those start values that are of their parameters, and these values."""
    own = {v.name: values[v.name] for v in variables if v.causality == "parameter" and v.name in values}
    return tuple(replace(v, start=own[v.name]) if v.name in own else v for v in variables), own


def _typed(variable: Variable, value: Any) -> Any:
    text = str(value).strip().lower()
    try:
        if variable.type == "Boolean":
            found: Any = _TRUTH[text]
        else:
            found = float(value)
            if variable.type != "Real":
                found = (variable.items or {}).get(text, int(found) if found.is_integer() else None)
        if found is not None and is_acceptable(variable, found):
            return found
    except (KeyError, TypeError, ValueError, OverflowError):
        pass
    expected = "true or false" if variable.type == "Boolean" else expected_value(variable)
    raise UsageError.report(f"start value of {variable.name}", expected=expected, received=repr(value))
