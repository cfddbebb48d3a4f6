"""The figures of the page, as Plotly takes them: plain dictionaries, thinned so that their peaks stay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ndob_fmu.log.diagnostics import LAGS
from ndob_fmu.log.tune.workbench import Band, Shown
from ndob_fmu.results.shown_time import ShownTime
from ndob_fmu.results.thinning import thinned
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations

_ONLINE, _LAGGED, _SMOOTHED = (31, 95, 168), (0, 128, 96), (179, 54, 30)
_GREY = "rgba(90, 100, 112, 0.22)"
_DIGITS = 6
# Bars at the start are as wide as the state is unknown; an axis shows all but these shares.
_QUANTILES = (0.005, 0.995)

Figure = dict[str, Any]


def disturbance_figure(equations: Equations, time: Array, shown: Shown, read: ShownTime) -> Figure:
    """Return each disturbance with its estimates and their bands of two standard deviations."""
    time = read.of(time)
    traces, labels, ranges = [], [], []
    for j, name in enumerate(equations.disturbances):
        drawn = [("online", shown.online, _ONLINE), ("smoothed", shown.smoothed, _SMOOTHED)]
        drawn += [("lagged", shown.lagged, _LAGGED)] if shown.lagged is not None else []
        for label, band, color in drawn:
            traces += _with_band(j, time, band, j, label, color)
        labels.append(_label(name, equations))
        ends = [one.d[:, j] + sign * one.std[:, j] for _, one, _ in drawn for sign in (-2.0, 2.0)]
        ranges.append(_usual(ends))
    return _figure(traces, labels, ranges, read.label, (time[0], time[-1]))


def residual_figure(equations: Equations, time: Array, shown: Shown, read: ShownTime) -> Figure:
    """Return the residuals of each output with their band of two standard deviations."""
    time = read.of(time)
    traces, labels, ranges = [], [], []
    for i, name in enumerate(equations.outputs):
        residual, bar = shown.residual[:, i], 2.0 * shown.residual_std[:, i]
        traces.append(_band(i, time, -bar, bar, "± 2 std", _GREY, show=i == 0))
        rows = thinned(residual)
        line = _trace(i, time[rows], residual[rows], "residual")
        traces.append(
            {**line, "mode": "markers", "marker": {"size": 3, "color": _rgb(_SMOOTHED)}, "showlegend": i == 0}
        )
        labels.append(_label(name, equations))
        ranges.append(_usual([residual, -bar, bar]))
    return _figure(traces, labels, ranges, read.label, (time[0], time[-1]))


def correlation_figure(equations: Equations, shown: Shown) -> Figure:
    """Return the correlation of the residuals of each output with its band."""
    traces, labels = [], []
    apart = np.arange(1.0, LAGS + 1.0)
    for i, name in enumerate(equations.outputs):
        found = shown.diagnoses[name]
        edge = np.full(2, found.correlation_band)
        traces.append(_band(i, np.array([0.5, LAGS + 0.5]), -edge, edge, "by chance", _GREY, show=i == 0))
        bars = _trace(i, apart, found.correlation, "correlation of residuals")
        traces.append({**bars, "type": "bar", "marker": {"color": _rgb(_ONLINE)}, "width": 0.6, "showlegend": i == 0})
        labels.append(name)
    return _figure(traces, labels, [(-1.0, 1.0)] * len(labels), "samples apart", (0.5, LAGS + 0.5))


def _figure(
    traces: list[Figure],
    labels: Sequence[str],
    ranges: Sequence[tuple[float, float]],
    below: str,
    reach: tuple[float, float],
) -> Figure:
    """Return panels from top to bottom over one axis, from one end of `reach` to the other."""
    count = len(labels)
    layout: Figure = {
        "margin": {"l": 80, "r": 20, "t": 10, "b": 45},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "height": 100 + 190 * count,
        "plot_bgcolor": "white",
        "font": {"size": 13, "color": "#1c2530"},
        "uirevision": "kept",  # what a user has zoomed into stays at a change
        "xaxis": {
            "title": {"text": below},
            "range": [float(f"{end:.9g}") for end in reach],
            "anchor": f"y{count}" if count > 1 else "y",
            "gridcolor": "#e4e8ec",
            "zeroline": False,
        },
    }
    for k, (label, limits) in enumerate(zip(labels, ranges, strict=True)):
        top = 1.0 - k / count
        layout["yaxis" if k == 0 else f"yaxis{k + 1}"] = {
            "title": {"text": label},
            "domain": [top - 0.92 / count, top],
            "range": list(limits),
            "gridcolor": "#e4e8ec",
            "zeroline": False,
        }
    return {"data": traces, "layout": layout}


def _with_band(panel: int, time: Array, band: Band, j: int, name: str, color: tuple[int, int, int]) -> list[Figure]:
    value, bar = band.d[:, j], 2.0 * band.std[:, j]
    rows = thinned(value)
    line = _trace(panel, time[rows], value[rows], name)
    shade = _band(panel, time, value - bar, value + bar, f"{name} ± 2 std", _rgb(color, 0.16), show=panel == 0)
    return [
        {**shade, "legendgroup": name},
        {**line, "legendgroup": name, "showlegend": panel == 0, "line": {"width": 1.4, "color": _rgb(color)}},
    ]


def _band(panel: int, x: Array, low: Array, high: Array, name: str, color: str, *, show: bool) -> Figure:
    rows = np.union1d(thinned(low), thinned(high))
    rows = rows[np.isfinite(low[rows]) & np.isfinite(high[rows])]
    around = _trace(
        panel, np.concatenate([x[rows], x[rows][::-1]]), np.concatenate([high[rows], low[rows][::-1]]), name
    )
    style = {"fill": "toself", "fillcolor": color, "line": {"width": 0}, "hoverinfo": "skip", "showlegend": show}
    return {**around, **style}


def _trace(panel: int, x: Array, y: Array, name: str) -> Figure:
    axis = {} if panel == 0 else {"yaxis": f"y{panel + 1}"}
    return {"type": "scatter", "mode": "lines", "x": _short(x, 9), "y": _short(y, _DIGITS), "name": name, **axis}


def _short(values: Array, digits: int) -> list[float | None]:
    """Return values in few digits, None where there is none: the page is to get few bytes."""
    known = np.isfinite(values) & (values != 0.0)
    size = np.abs(np.where(known, values, 1.0))
    places = digits - 1.0 - np.floor(np.log10(size))
    # Powers of ten above 1 are exact numbers; so one division gives the number of few digits.
    up, down = 10.0 ** np.maximum(places, 0.0), 10.0 ** np.maximum(-places, 0.0)
    rounded = np.where(known, np.round(np.where(known, values, 0.0) * up / down) / up * down, 0.0)
    found = rounded.astype(object)
    found[~np.isfinite(values)] = None
    return list(found.tolist())


def _usual(signals: Sequence[Array]) -> tuple[float, float]:
    """Return the range of an axis for the usual values of signals."""
    low, high = np.nanquantile(np.concatenate(signals), _QUANTILES).tolist()
    room = 0.1 * (high - low) or 1.0
    return low - room, high + room


def _label(name: str, equations: Equations) -> str:
    return f"{name} [{equations.units.get(name) or '1'}]"


def _rgb(color: tuple[int, int, int], alpha: float = 1.0) -> str:
    return f"rgba({color[0]}, {color[1]}, {color[2]}, {alpha})"
