"""The content of a report: text, tables and figures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import plotly.graph_objects as go


@dataclass(frozen=True)
class Table:
    """Rows of text under a heading; the first column names the row."""

    title: str
    rows: list[tuple[str, ...]]
    header: tuple[str, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class Section:
    """Figures, each with a caption, under a heading."""

    title: str
    figures: list[tuple[str, go.Figure]]


@dataclass(frozen=True)
class Content:
    """The content of a page, in its order.

    lead: one sentence under the title.
    first: the section that answers the reader's main question.
    """

    title: str
    lead: str
    first: Section
    summary: Table
    sections: list[Section]
    tables: list[Table] = field(default_factory=list)


def text(value: Any) -> str:
    """Return a value as a table shows it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "–" if value is None else str(value)


def pretty(unit: str) -> str:
    """Return a unit as people write it."""
    return unit.replace(".", "·")
