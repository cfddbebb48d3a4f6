"""The report of a study: measures over the parameters, failures with their reasons, and the study's description."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from ndob_fmu.report.content import Content, Section, Table, pretty, text
from ndob_fmu.report.lines import LAYOUT
from ndob_fmu.results.json_files import read_sealed_json
from ndob_fmu.study.axes import Axis, axes_of, cell_medians, named, pairs_of, parameters_of, point_medians
from ndob_fmu.study.columns import RUN
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
    parameters = parameters_of(plan, table)
    measures = [axis for axis in axes_of(table, list(plan["measures"])) if np.isfinite(axis.values).any()]
    drawn = measures if parameters else []
    runs = column(table, RUN)
    made = _summary(folder)
    return Content(
        title=f"Study {plan['name']} of {plan['system']}",
        lead=f"{found['finished']} of {plan['runs']} runs finished, {found['failed']} of them failed; "
        "each is a row of runs.csv.",
        first=Section("All runs", [_parallel(parameters, measures, units)] if drawn else []),
        summary=Table(
            "Measures",
            [*_statistics(found["measures"], units)],
            ("measure", "min", "in run", "median", "max", "in run", "finite in"),
        ),
        sections=[
            Section(
                "Two parameters", [_two_parameters(parameters, one, units) for one in drawn if len(parameters) > 1]
            ),
            Section("One parameter", [_scatter(parameters, one, runs, units) for one in drawn]),
        ],
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
    """Return the values for the colours, logarithmic where they span decades, and the colour bar."""
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


def _two_parameters(parameters: Sequence[Axis], measure: Axis, units: dict[str, str]) -> tuple[str, go.Figure]:
    """Show a measure as colour over two parameters: in cells, or as points where every run has a value of its own."""
    pairs = pairs_of(parameters)
    figure = go.Figure()
    layouts: list[dict[str, Any]] = []
    for k, (x, y) in enumerate(pairs):
        before = len(figure.data)
        add = _add_points if x.drawn or y.drawn else _add_cells
        words = add(figure, x, y, measure, units)
        for trace in figure.data[before:]:
            trace.update(visible=k == 0, meta=k)
        layouts.append(_axis_of("xaxis", x, units, words) | _axis_of("yaxis", y, units, words))
    owners = [trace.meta for trace in figure.data]
    buttons = [
        {
            "label": f"{x.name} × {y.name}",
            "method": "update",
            "args": [{"visible": [owner == k for owner in owners]}, layouts[k]],
        }
        for k, (x, y) in enumerate(pairs)
    ]
    figure.update_layout(LAYOUT, height=450, hovermode="closest", showlegend=False, margin={"t": 60})
    figure.update_layout({key.replace(".", "_"): value for key, value in layouts[0].items()})
    if len(pairs) > 1:
        figure.update_layout(updatemenus=[{"buttons": buttons, "x": 0, "y": 1.18, "xanchor": "left"}])
    caption = [f"Median of {measure.name} over two parameters{'; the list chooses which' if len(pairs) > 1 else ''}."]
    if any(axis.drawn for axis in parameters):
        caption.append("A drawn parameter has points in place of cells, a cross where no run has a value.")
    return " ".join(caption), figure


def _add_cells(figure: go.Figure, x: Axis, y: Axis, measure: Axis, units: dict[str, str]) -> bool:
    """Add a heat map; return True, since its axes have labels in place of numbers."""
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
    )
    return True


def _add_points(figure: go.Figure, x: Axis, y: Axis, measure: Axis, units: dict[str, str]) -> bool:
    """Add a point for each run, a cross where the measure has no value; return False, since its axes have numbers."""
    across, up, medians = point_medians(x, y, measure)
    values, bar = _colors(Axis(measure.name, medians), units)
    known = np.isfinite(medians)
    places = [_as_shown(x, across), _as_shown(y, up)]
    size = float(np.clip(400.0 / np.sqrt(len(known)), 4.0, 11.0))
    marker = {"color": values[known], "colorscale": "Viridis", "colorbar": bar, "size": size}
    marker |= {"line": {"width": 0.5, "color": "#444"}}
    texts = [f"{measure.name} {value:.4g}" for value in medians[known]]
    _points(figure, x=places[0][known], y=places[1][known], mode="markers", marker=marker, text=texts)
    if not known.all():
        missing = {"symbol": "x", "color": "#888", "size": size}
        no_value = {"mode": "markers", "marker": missing, "text": f"no {measure.name}"}
        _points(figure, x=places[0][~known], y=places[1][~known], **no_value)
    return False


def _points(figure: go.Figure, **scatter: Any) -> None:
    """Add points, more of them than a browser draws one by one through its graphics card."""
    add = figure.add_scattergl if len(scatter["x"]) > _MOST_LINES else figure.add_scatter
    add(**scatter)


def _as_shown(axis: Axis, values: Any) -> Any:
    return np.array(axis.words)[values.astype(int)] if axis.words else values


def _axis_of(which: str, axis: Axis, units: dict[str, str], words: bool = False) -> dict[str, Any]:
    """Return the entries of a layout for the axis ``which``; words: whether its values are labels of cells."""
    kind = "category" if axis.words or words else "log" if axis.log else "linear"
    decades = np.ptp(np.log10(axis.values[np.isfinite(axis.values)])) if kind == "log" else 0.0
    entries = {
        "title.text": named(axis, units),
        "type": kind,
        "autorange": True,
        "exponentformat": "power",
        "dtick": None if kind != "log" else 1 if decades > 1.5 else "D2",
    }
    return {f"{which}.{name}": value for name, value in entries.items()}


def _scatter(parameters: Sequence[Axis], measure: Axis, runs: Any, units: dict[str, str]) -> tuple[str, go.Figure]:
    figure, buttons = go.Figure(), []
    parameters = sorted(parameters, key=lambda axis: not axis.drawn)
    for k, axis in enumerate(parameters):
        x = _as_shown(axis, axis.values)
        _points(
            figure,
            x=x,
            y=measure.values,
            mode="markers",
            marker={"size": 5, "opacity": 0.6},
            text=[f"run {run}" for run in runs],
            visible=k == 0,
        )
        shown = {"visible": [other == k for other in range(len(parameters))]}
        layout = _axis_of("xaxis", axis, units)
        buttons.append({"label": axis.name, "method": "update", "args": [shown, layout]})
    figure.update_layout(LAYOUT, height=400, hovermode="closest", showlegend=False, margin={"t": 60})
    shown_first = _axis_of("xaxis", parameters[0], units) | _axis_of("yaxis", measure, units)
    figure.update_layout({key.replace(".", "_"): value for key, value in shown_first.items()})
    figure.update_layout(updatemenus=[{"buttons": buttons, "x": 0, "y": 1.18, "xanchor": "left"}])
    return f"{measure.name} of each run over a parameter; the list chooses which.", figure
