"""The report of a study: the measures over the parameters, what failed and why, and what was asked."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from ndob_fmu.report.content import Content, Table, pretty, text
from ndob_fmu.report.run import LAYOUT
from ndob_fmu.results import read_sealed_json
from ndob_fmu.study.columns import RUN
from ndob_fmu.study.figures import Axis, axes_of, cell_medians, named
from ndob_fmu.study.plan import read_plan
from ndob_fmu.study.store import column, read_runs
from ndob_fmu.study.summary import statistics

_MOST_LINES = 5000
_BEST = 10


def study_content(folder: Path) -> Content:
    """Return the report of the study in ``folder``, finished or not."""
    plan, table = read_plan(folder), read_runs(folder)
    units = {name: pretty(unit) for name, unit in plan["units"].items()}
    found = statistics(table, plan)
    parameters = [axis for axis in axes_of(table, list(plan["varied"])) if len(np.unique(axis.values)) > 1]
    measures = [axis for axis in axes_of(table, list(plan["measures"])) if np.isfinite(axis.values).any()]
    figures: list[tuple[str, go.Figure]] = []
    if parameters and measures:
        figures.append(_parallel(parameters, measures, units))
        if len(parameters) > 1:
            figures += [_heat_map(parameters, measure, units) for measure in measures]
        figures += [_scatter(parameters, measure, column(table, RUN), units) for measure in measures]
    made = _summary(folder)
    return Content(
        title=f"Study {plan['name']} of {plan['system']}",
        lead=f"{found['finished']} of {plan['runs']} runs finished, {found['failed']} of them failed; "
        "each is a row of runs.csv.",
        summary=Table(
            "Measures",
            [*_statistics(found["measures"], units)],
            ("measure", "min", "in run", "median", "max", "in run", "finite in"),
        ),
        figures=figures,
        tables=[
            *_best(table, plan, measures, units),
            Table("Failures", [(reason, str(count)) for reason, count in found["reasons"].items()], ("reason", "runs")),
            Table("What varies", [(name, _varied(how), units.get(name, "")) for name, how in plan["varied"].items()]),
            Table("What is fixed", [(k, text(v), "") for k, v in {**plan["fixed"], **plan["simulation"]}.items()]),
            Table("Measures as asked for", [(k, json.dumps(v)) for k, v in plan["measures"].items()]),
            Table("Last call", [(k.replace("_", " "), text(v)) for k, v in made.get("last_call", {}).items()]),
            Table("Versions", [(name, text(value)) for name, value in made.get("versions", {}).items()]),
        ],
    )


def _summary(folder: Path) -> dict[str, Any]:
    path = folder / "summary.json"  # absent while the study is under way
    found = read_sealed_json(path) if path.exists() else {}
    return {name: entries for name, entries in found.items() if isinstance(entries, dict)}


def _statistics(found: Mapping[str, Mapping[str, Any]], units: Mapping[str, str]) -> Iterator[tuple[str, ...]]:
    for name, entry in found.items():
        label = f"{name} [{units[name]}]" if name in units else name
        keys = ("min", "run_of_min", "median", "max", "run_of_max", "finite")
        yield (label, *(text(entry.get(key)) for key in keys))


def _varied(how: Any) -> str:
    if isinstance(how, dict):
        return f"{text(how['from'])} … {text(how['to'])}, {how['values']} values"
    return ", ".join(map(text, how))


def _best(table: Any, plan: Mapping[str, Any], measures: Sequence[Axis], units: Mapping[str, str]) -> Iterator[Table]:
    for measure in measures[:1]:
        order = np.argsort(measure.values)[:_BEST]
        names = [*plan["varied"], *plan["measures"]]
        rows = [(str(row[RUN]), *(text(row[name]) for name in names)) for row in table.take(order).to_pylist()]
        yield Table(f"Runs with the least {measure.name}", rows, ("run", *(_label(name, units) for name in names)))


def _label(name: str, units: Mapping[str, str]) -> str:
    return f"{name} [{units[name]}]" if name in units else name


def _colors(axis: Axis, units: dict[str, str]) -> tuple[Any, dict[str, Any]]:
    """Return what to colour by, logarithmic where it spans decades, and the bar that explains the colours."""
    known = axis.values[np.isfinite(axis.values)]
    marks = (np.geomspace if axis.log else np.linspace)(known.min(), known.max(), 5)
    ticks = np.log10(marks) if axis.log else marks
    labels = [axis.label(mark) for mark in marks]
    bar = {"title": {"text": named(axis, units)}, "tickvals": ticks.tolist(), "ticktext": labels}
    return np.log10(axis.values) if axis.log else axis.values, bar


def _parallel(parameters: Sequence[Axis], measures: Sequence[Axis], units: dict[str, str]) -> tuple[str, go.Figure]:
    everything = [*parameters, *measures]
    total = len(measures[0].values)
    chosen = np.linspace(0, total - 1, min(total, _MOST_LINES)).astype(int)
    dimensions = []
    for axis in everything:
        values, ticks, labels = axis.drawable()
        dimensions.append(
            {"label": named(axis, units), "values": values[chosen], "tickvals": ticks, "ticktext": labels}
        )
    _, bar = _colors(measures[0], units)
    line = {"color": measures[0].drawable()[0][chosen], "colorscale": "Viridis", "showscale": True, "colorbar": bar}
    line |= {"cmin": bar["tickvals"][0], "cmax": bar["tickvals"][-1]}
    figure = go.Figure(go.Parcoords(line=line, dimensions=dimensions, labelangle=-12, labelside="bottom"))
    figure.update_layout(LAYOUT, height=440, margin={"l": 80, "r": 40, "t": 30, "b": 90})
    shown = "every finished run" if len(chosen) == total else f"{len(chosen)} of {total} finished runs"
    return f"Each line is a run ({shown}); drag along an axis to select, drag an axis to move it.", figure


def _heat_map(parameters: Sequence[Axis], measure: Axis, units: dict[str, str]) -> tuple[str, go.Figure]:
    pairs = [(x, y) for k, x in enumerate(parameters) for y in parameters[k + 1 :]]
    figure, buttons = go.Figure(), []
    for k, (x, y) in enumerate(pairs):
        cells, columns, rows = cell_medians(x, y, measure)
        values, bar = _colors(Axis(measure.name, cells), units)
        figure.add_heatmap(
            z=values,
            x=columns,
            y=rows,
            customdata=cells,
            hovertemplate="%{x}<br>%{y}<br>median %{customdata:.4g}<extra></extra>",
            colorscale="Viridis",
            colorbar=bar,
            visible=k == 0,
        )
        titles = {"xaxis.title.text": named(x, units), "yaxis.title.text": named(y, units)}
        shown = {"visible": [other == k for other in range(len(pairs))]}
        buttons.append({"label": f"{x.name} × {y.name}", "method": "update", "args": [shown, titles]})
    figure.update_layout(LAYOUT, height=430, xaxis_type="category", yaxis_type="category", hovermode="closest")
    figure.update_layout(
        xaxis_title_text=named(pairs[0][0], units), yaxis_title_text=named(pairs[0][1], units), margin={"t": 60}
    )
    if len(pairs) > 1:
        figure.update_layout(updatemenus=[{"buttons": buttons, "x": 0, "y": 1.18, "xanchor": "left"}])
    return f"Median of {measure.name} over two parameters; the list chooses which.", figure


def _scatter(parameters: Sequence[Axis], measure: Axis, runs: Any, units: dict[str, str]) -> tuple[str, go.Figure]:
    figure, buttons = go.Figure(), []
    kinds = ["category" if axis.words else "log" if axis.log else "linear" for axis in parameters]
    for k, axis in enumerate(parameters):
        x = [axis.label(value) for value in axis.values] if axis.words else axis.values
        figure.add_scatter(
            x=x,
            y=measure.values,
            mode="markers",
            marker={"size": 5, "opacity": 0.6},
            text=[f"run {run}" for run in runs],
            visible=k == 0,
        )
        shown = {"visible": [other == k for other in range(len(parameters))]}
        layout = {"xaxis.title.text": named(axis, units), "xaxis.type": kinds[k], "xaxis.autorange": True}
        buttons.append({"label": axis.name, "method": "update", "args": [shown, layout]})
    figure.update_layout(LAYOUT, height=400, hovermode="closest", showlegend=False, margin={"t": 60})
    figure.update_xaxes(title_text=named(parameters[0], units), type=kinds[0])
    figure.update_yaxes(
        title_text=named(measure, units), type="log" if measure.log else "linear", exponentformat="power"
    )
    figure.update_layout(updatemenus=[{"buttons": buttons, "x": 0, "y": 1.18, "xanchor": "left"}])
    return f"{measure.name} of each run over a parameter; the list chooses which.", figure
