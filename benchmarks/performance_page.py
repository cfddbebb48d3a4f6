"""The page: all ratios, then for each how it was measured and its times."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from textwrap import wrap

from benchmarks.figures import Ratio, Section

PACKAGES = ("numpy", "fmpy", "pythonfmu", "libcosimpy", "ecospy")

_TOP = """# Performance

<!-- Written by `python -m benchmarks.performance`; changes belong there. -->

Each figure is a ratio of times that were measured in turns in one run: the median over the rounds, with its quartiles.
Ratios depend less on the machine than times do. The times are processor times if nothing else is said. Below 1 ours is
faster. A bound is a requirement of this project.

Measured with Python {python}, {packages}, on {processors} processors.
"""


def text(sections: Iterable[Section]) -> str:
    """Return the page in Markdown."""
    ordered = sorted(sections, key=lambda section: section.rank)
    top = _TOP.format(
        python=platform.python_version(),
        packages=", ".join(f"{name} {version(name)}" for name in PACKAGES),
        processors=os.cpu_count(),
    )
    parts = [top, "## Ratios\n", ratio_table([row for section in ordered for row in section.ratios])]
    for section in ordered:
        parts += [f"## {section.title}\n", "\n".join(wrap(section.text, 120)) + "\n"]
        parts.append(_table(("", "median"), [(row.what, duration(row.seconds)) for row in section.times]))
    return "\n".join(parts)


def ratio_table(rows: Sequence[Ratio]) -> str:
    """Return the table of ratios."""
    return _table(
        ("ours", "over", "ratio", "quartiles", "bound", ""),
        [
            (
                row.what,
                row.peer,
                f"**{row.median:.3g}**",
                f"{row.low:.3g} – {row.high:.3g}",
                "" if row.required is None else f"≤ {row.required:.3g}",
                "" if row.required is None else "met" if row.median <= row.required else "**not met**",
            )
            for row in rows
        ],
    )


def duration(seconds: float) -> str:
    """Return a time with a unit in which it has up to three digits before the point."""
    unit, size = next(((u, s) for u, s in (("s", 1.0), ("ms", 1e-3)) if seconds >= s), ("µs", 1e-6))
    return f"{seconds / size:.3g} {unit}"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
