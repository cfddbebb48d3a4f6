"""The report of one run: estimates beside the truth, every signal, and how the run came about."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ndob_fmu.report.content import Content, Table, pretty, text
from ndob_fmu.report.signals import estimates, thinned
from ndob_fmu.results import Recording
from ndob_fmu.run_files import read_run

LAYOUT: dict[str, Any] = {
    "template": "plotly_white",
    "margin": {"l": 70, "r": 20, "t": 30, "b": 50},
    "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"},
    "hovermode": "x unified",
}


def run_content(folder: Path) -> Content:
    """Return the report of the run whose result.csv, and summary.json if there is one, lie in ``folder``."""
    recording, summary = read_run(folder)
    units = {name: pretty(unit) for name, unit in summary.get("units", {}).items()}
    span = f"{recording.time[0]:g} to {recording.time[-1]:g} s"
    system = summary.get("system") or folder.name
    return Content(
        title=f"Simulation of {system}",
        lead=f"{len(recording.names)} signals in {len(recording.time)} rows from {span}; all of them in result.csv.",
        summary=Table(
            "Summary", [*_flat({k: v for k, v in summary.items() if k not in _SEPARATE})] or [("rows", span)]
        ),
        figures=[*_pairs(recording, units), *_everything(recording, units)],
        tables=[
            Table(
                "Parameters",
                [(name, text(value), units.get(name, "")) for name, value in summary.get("parameters", {}).items()],
                ("name", "value", "unit"),
            ),
            Table("Versions", [(name, text(value)) for name, value in summary.get("versions", {}).items()]),
        ],
    )


_SECONDS = ("step_size", "start_time", "stop_time", "wall_time", "settling_time")
_SEPARATE = ("parameters", "units", "versions", "system")


def _flat(entries: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, value in entries.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name.replace('_', ' ')}: ")
        else:
            label = f"{prefix}{name.replace('_', ' ')}"
            yield f"{label} [s]" if name.startswith(_SECONDS) else label, text(value)


def _pairs(recording: Recording, units: Mapping[str, str]) -> Iterator[tuple[str, go.Figure]]:
    pairs = estimates(recording.names)
    # What the observer is for comes first.
    for truth, estimate in sorted(pairs, key=lambda pair: not pair[0].endswith("_total")):
        figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
        true, estimated = recording[truth], recording[estimate]
        figure.add_trace(_line(recording.time, true, truth, "#444", dash="dash"), row=1, col=1)
        figure.add_trace(_line(recording.time, estimated, estimate, "#1f77b4"), row=1, col=1)
        error = np.maximum(np.abs(estimated - true), 1e-16)
        figure.add_trace(_line(recording.time, error, "|difference|", "#d62728"), row=2, col=1)
        figure.update_layout(LAYOUT, height=480)
        unit = units.get(truth, "")
        figure.update_yaxes(title_text=f"{truth.partition('.')[2]} [{unit or '1'}]", row=1, col=1)
        figure.update_yaxes(
            title_text=f"|difference| [{unit or '1'}]", type="log", exponentformat="power", row=2, col=1
        )
        figure.update_xaxes(title_text="time [s]", row=2, col=1)
        yield f"{estimate} and {truth} over time, and the difference between them.", figure


def _everything(recording: Recording, units: Mapping[str, str]) -> Iterator[tuple[str, go.Figure]]:
    panels: dict[tuple[str, str], list[str]] = {}
    for name in recording.names:
        panels.setdefault((name.partition(".")[0], units.get(name, "")), []).append(name)
    for (component, unit), names in panels.items():
        figure = go.Figure([_line(recording.time, recording[name], name) for name in names])
        figure.update_layout(LAYOUT, height=320, showlegend=True)
        figure.update_yaxes(title_text=f"{component} [{unit or '1'}]")
        figure.update_xaxes(title_text="time [s]")
        yield f"{component}: {', '.join(name.removeprefix(f'{component}.') for name in names)}.", figure


def _line(time: Any, values: Any, name: str, color: str | None = None, dash: str | None = None) -> go.Scatter:
    rows = thinned(values)
    # Single precision is more than a screen shows, and half the file.
    x, y = time[rows].astype(np.float32), values[rows].astype(np.float32)
    return go.Scatter(x=x, y=y, name=name, mode="lines", line={"color": color, "dash": dash})
