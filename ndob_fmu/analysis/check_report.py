"""The result of the checks, one row for each: as a table, as JSON, or as the one-line error of the first that fails."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ndob_fmu.errors import AssumptionError


@dataclass(frozen=True)
class CheckRow:
    """One assumption.

    name: for programs.
    passed: whether it holds.
    requirement: what must hold.
    measured: what was found.
    failure: where it fails, the modes, ranks or zeros at fault.
    likely: where it fails, the likely cause.
    values: the numbers found.
    """

    name: str
    passed: bool
    requirement: str
    measured: str
    failure: str = ""
    likely: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class CheckReport:
    """All assumptions for one model at one α (1/s), in the order in which a user should mend them."""

    model: str
    alpha: float
    rows: tuple[CheckRow, ...]

    @property
    def passed(self) -> bool:
        """Whether every assumption holds."""
        return all(row.passed for row in self.rows)

    def __getitem__(self, name: str) -> CheckRow:
        """Return the row of that name."""
        return next(row for row in self.rows if row.name == name)

    def require(self) -> CheckReport:
        """Return the report itself. Raises AssumptionError, naming the first assumption that fails."""
        for row in self.rows:
            if not row.passed:
                raise AssumptionError.report(
                    f"{self.model}: {row.name}", expected=row.requirement, received=row.failure, likely=row.likely
                )
        return self

    def __str__(self) -> str:
        failed = sum(not row.passed for row in self.rows)
        verdict = f"{failed} of {len(self.rows)} checks FAIL" if failed else f"all {len(self.rows)} checks pass"
        lines = [f"{self.model}: {verdict} at alpha = {self.alpha:g} 1/s"]
        names = max(len(row.name) for row in self.rows)
        requirements = max(len(row.requirement) for row in self.rows)
        for row in self.rows:
            mark = "ok  " if row.passed else "FAIL"
            lines.append(f"  {mark}  {row.name:<{names}}  {row.requirement:<{requirements}}  {row.measured}")
            if not row.passed:
                cause = f"; likely cause: {row.likely}" if row.likely else ""
                lines.append(f"        {'':<{names}}  > {row.failure}{cause}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the report in JSON's types; numbers that are not finite become null."""
        rows = [
            {
                "name": row.name,
                "passed": row.passed,
                "requirement": row.requirement,
                "measured": row.measured,
                "failure": row.failure,
                "likely_cause": row.likely,
                "values": _plain(row.values),
            }
            for row in self.rows
        ]
        return {"model": self.model, "alpha": self.alpha, "passed": self.passed, "rows": rows}


def _plain(value: Any) -> Any:
    """Return the value in lists, dicts and finite numbers; a complex number as [real, imaginary]."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return [_plain(entry) for entry in value.tolist()]
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
