"""One figure that is required: what it is, what it was once, the limit and the measured value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """One requirement; errors are RMS in D₀.

    once: what the first version reached
    limit: what is required, at most, or at least where `at_least`
    measured: None where the FMU lacks what is needed
    note: why it could not be measured
    timed: whether it is a time, which differs from run to run
    """

    text: str
    limit: float
    measured: float | None
    once: str = "–"
    at_least: bool = False
    note: str = ""
    timed: bool = False

    @property
    def short(self) -> bool:
        """Whether the requirement is missed."""
        if self.measured is None:
            return True
        kept = self.measured >= self.limit if self.at_least else self.measured <= self.limit
        return not kept


def as_text(figures: Sequence[Figure]) -> str:
    """Return the figures as a Markdown table."""
    lines = ["| through the FMUs | once | required | measured | |", "|---|---|---|---|---|"]
    for figure in figures:
        sign = "≥" if figure.at_least else "≤"
        measured = figure.note if figure.measured is None else f"{figure.measured:.4g}"
        verdict = "**short**" if figure.short else "ok"
        lines.append(f"| {figure.text} | {figure.once} | {sign} {figure.limit:.4g} | {measured} | {verdict} |")
    return "\n".join(lines)
