"""study.json: the description of a study in its results folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ndob_fmu.errors import UsageError, some_of
from ndob_fmu.results.json_files import read_sealed_json

PLAN = "study.json"
_TYPES = {
    "name": str,
    "system": str,
    "runs": int,
    "digest": str,
    "simulation": dict,
    "fixed": dict,
    "varied": dict,
    "measures": dict,
    "units": dict,
}
_RANGE = {"from", "to", "values"}


def read_plan(folder: Path) -> dict[str, Any]:
    """Return study.json; raise UsageError if there is none, or it is not as it was written."""
    path = folder / PLAN
    plan = read_sealed_json(path)
    wrong = [name for name, kind in _TYPES.items() if not isinstance(plan.get(name), kind)]
    if not wrong:
        wrong += [name for name, how in plan["varied"].items() if not _is_varied(how)]
        wrong += [name for name, unit in plan["units"].items() if not isinstance(unit, str)]
    if wrong:
        raise UsageError.report(
            str(path), expected="the plan of a study", received=f"no valid {some_of(wrong)}", likely="it was edited"
        )
    return plan


def _is_varied(how: Any) -> bool:
    """Return whether this is what a plan says of a parameter that varies: its values, or their range and number."""
    return isinstance(how, list) or (isinstance(how, dict) and set(how) == _RANGE)
