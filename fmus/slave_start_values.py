"""Start values that lie in the FMU beside its code and take the place of the model's.

A packed system writes them there, so that tools start its FMUs as it says also where they do not read its parameters.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fmus.slave_variables import is_declared
from ndob_fmu.interface.variables import Variable
from ndob_fmu.runtime.base_errors import NdobError

FILE = "start_values.json"


def with_start_values(variables: Sequence[Variable], resources: str | None) -> tuple[Variable, ...]:
    """Return the variables with the start values that the file in the resources has for them.

    Raises NdobError where one is not of its variable's type.
    """
    file = Path(resources or "", FILE)
    given = json.loads(file.read_text("utf-8")) if file.is_file() else {}
    return tuple(v if v.start is None else replace(v, start=_typed(v, given.get(v.name, v.start))) for v in variables)


def _typed(variable: Variable, value: Any) -> Any:
    """Return a start value as its type is in Python; a Real may be written without a point."""
    if variable.type == "Real" and type(value) is int:
        value = float(value)
    if not is_declared(variable, value):
        raise NdobError.report(
            f"start value of {variable.name}", expected=f"one of type {variable.type}", received=f"{value!r}"
        )
    return value
