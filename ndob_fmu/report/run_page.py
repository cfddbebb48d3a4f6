"""The report of one run: estimates with their error bars first, then inputs, outputs, all signals and settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from ndob_fmu.report.content import Content, Section, Table, text
from ndob_fmu.report.lines import Panels
from ndob_fmu.report.observers import disturbance_figures, input_figures, output_figures, state_figures
from ndob_fmu.report.recorded_run import RecordedRun, read_recorded_run
from ndob_fmu.report.signals import usual_range


def run_content(folder: Path) -> Content:
    """Return the report of the run whose result.csv, and summary.json if there is one, lie in ``folder``."""
    record = read_recorded_run(folder)
    recording, summary, units = record.recording, record.summary, record.units
    shown = record.shown_time.text
    span = f"{record.time[0]:g} to {record.time[-1]:g} s" + (f" ({shown})" if shown else "")
    system = summary.get("system") or folder.name
    return Content(
        title=f"Simulation of {system}",
        lead=f"{len(recording.names)} signals in {len(recording.time)} rows from {span}; all of them in result.csv.",
        first=Section("Estimated disturbances", [*disturbance_figures(record)]),
        summary=Table(
            "Summary", [*_flat({k: v for k, v in summary.items() if k not in _SEPARATE})] or [("rows", span)]
        ),
        sections=[
            Section("Inputs", [*input_figures(record)]),
            Section("Measured outputs and residuals", [*output_figures(record)]),
            Section("Estimated states", [*state_figures(record)]),
            Section("All signals", [*_everything(record)]),
        ],
        tables=[
            Table(
                "Parameters",
                [(name, text(value), units.get(name, "")) for name, value in summary.get("parameters", {}).items()],
                ("name", "value", "unit"),
            ),
            Table("Versions", [(name, text(value)) for name, value in summary.get("versions", {}).items()]),
        ],
    )


_SECONDS = ("step_size", "output_interval", "start_time", "stop_time", "wall_time", "settling_time")
_SEPARATE = ("parameters", "units", "versions", "system", "connections")


def _flat(entries: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, value in entries.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name.replace('_', ' ')}: ")
        else:
            label = f"{prefix}{name.replace('_', ' ')}"
            shown = ", ".join(map(text, value)) if isinstance(value, list) else text(value)
            yield f"{label} [s]" if name.startswith(_SECONDS) else label, shown


def _everything(record: RecordedRun) -> Iterator[tuple[str, go.Figure]]:
    groups: dict[tuple[str, str], list[str]] = {}
    for name in record.recording.names:
        groups.setdefault((name.partition(".")[0], record.units.get(name, "")), []).append(name)
    for (component, unit), names in groups.items():
        panels = Panels([1.0])
        signals = [record.recording[name] for name in names]
        for name, signal in zip(names, signals, strict=True):
            panels.line(1, record.time, signal, name)
        panels.figure.update_layout(showlegend=True)
        limits = usual_range(*signals)
        panels.axis(1, f"{component} [{unit or '1'}]", limits)
        listed = ", ".join(name.removeprefix(f"{component}.") for name in names)
        cut = " The axis shows the usual range; double-click on the plot shows all." if limits else ""
        yield f"{component}: {listed}.{cut}", panels.figure
