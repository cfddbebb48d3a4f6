"""Start values that lie in the FMU beside its code and take the place of the model's.

A packed system writes them there, so that tools start its FMUs as it says also where they do not read its parameters.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ndob_fmu.runtime.interface import Variable

FILE = "start_values.json"


def with_start_values(variables: Sequence[Variable], resources: str | None) -> tuple[Variable, ...]:
    """Return the variables with the start values that the file in the resources has for them."""
    file = Path(resources or "", FILE)
    given = json.loads(file.read_text("utf-8")) if file.is_file() else {}
    return tuple(replace(v, start=given[v.name]) if v.name in given else v for v in variables)
