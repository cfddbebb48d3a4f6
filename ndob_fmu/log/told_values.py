"""The values of an observer's parameters for a log: the model's start values, and those that a user gives instead."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ndob_fmu.errors import UsageError
from ndob_fmu.interface.model_variables import METHODS, observer_variables
from ndob_fmu.model.start_values import typed_values
from ndob_fmu.runtime.equations import Equations


def told_values(equations: Equations, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the value of each parameter of `<Name>Observer`.

    given: start values by name, as numbers or as text

    Raises UsageError for a name that is no parameter, for a value that it cannot have, and for method 1, which has no
    error bars.
    """
    variables = observer_variables(equations)
    values = {v.name: v.start for v in variables if v.causality == "parameter"} | typed_values(variables, given)
    if values["method"] != METHODS["sampled_data"]:
        raise UsageError.report("method", expected="2 for a log", received="1", likely="--start-values method 2")
    return values


def ignored(line: str) -> None:
    """Take a warning about the values, which `estimate` gives too."""


def start_values_text(values: Mapping[str, Any]) -> str:
    """Return the content of a file that `read_start_values` reads."""
    return json.dumps(values, indent=2) + "\n"


def read_start_values(path: Path) -> dict[str, Any]:
    """Return the start values of a JSON file: an object of names and values.

    Raises UsageError for a file that cannot be read or has another content.
    """
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError.report(str(path), expected="a JSON file that can be read", received=str(error)) from error
    if not isinstance(found, dict) or not all(isinstance(value, str | int | float) for value in found.values()):
        raise UsageError.report(
            str(path), expected='an object of names and values, {"lag": 0.02}', received=type(found).__name__
        )
    return found
