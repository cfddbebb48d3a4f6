"""The result of the checks, one row for each: as a table, as JSON, or as the one-line error of the first that fails."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ndob_fmu.errors import AssumptionError

Part = Literal["method 2", "method 1"]

_HEADINGS: Mapping[Part, str] = {"method 2": "method 2", "method 1": "method 1, the paper's assumptions"}


@dataclass(frozen=True)
class CheckRow:
    """One need of a method.

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
    """What each method needs of one model, at one α (1/s), in the order in which a user should mend it.

    decides: the part of the model's default method. The rows of the other part inform.
    parts: the rows of each part.
    """

    model: str
    alpha: float
    decides: Part
    parts: Mapping[Part, tuple[CheckRow, ...]]

    @property
    def rows(self) -> tuple[CheckRow, ...]:
        """The rows of both parts."""
        return tuple(row for rows in self.parts.values() for row in rows)

    @property
    def passed(self) -> bool:
        """Whether the model has all that its default method needs."""
        return self.holds(self.decides)

    def holds(self, part: Part) -> bool:
        """Return whether every row of a part passes."""
        return all(row.passed for row in self.parts[part])

    def __getitem__(self, name: str) -> CheckRow:
        """Return the row of that name."""
        return next(row for row in self.rows if row.name == name)

    def require(self, part: Part | None = None) -> CheckReport:
        """Return the report itself; part: None for that of the model's default method.

        Raises AssumptionError, naming the first row of the part that fails.
        """
        for row in self.parts[part or self.decides]:
            if not row.passed:
                raise AssumptionError.report(
                    f"{self.model}: {row.name}", expected=row.requirement, received=row.failure, likely=row.likely
                )
        return self

    def __str__(self) -> str:
        rows = self.parts[self.decides]
        failed = sum(not row.passed for row in rows)
        verdict = f"{failed} of {len(rows)} checks FAIL" if failed else f"all {len(rows)} checks pass"
        lines = [f"{self.model}: {verdict}, alpha = {self.alpha:g} 1/s"]
        names, requirements = (max(len(getattr(row, text)) for row in self.rows) for text in ("name", "requirement"))
        for part, rows in self.parts.items():
            decides = part == self.decides
            lines.append(_HEADINGS[part] + ("" if decides else f", for information: {self.decides} does without"))
            for row in rows:
                mark = "ok  " if row.passed else "FAIL" if decides else "no  "
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
                "part": part,
                "passed": row.passed,
                "requirement": row.requirement,
                "measured": row.measured,
                "failure": row.failure,
                "likely_cause": row.likely,
                "values": _plain(row.values),
            }
            for part, rows in self.parts.items()
            for row in rows
        ]
        return {
            "model": self.model,
            "alpha": self.alpha,
            "passed": self.passed,
            "decides": self.decides,
            "rows": rows,
        }


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
