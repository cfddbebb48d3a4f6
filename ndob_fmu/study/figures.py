"""The figures of a study: two parameters with a measure as colour, and parallel coordinates over all of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize

from ndob_fmu.results import plots
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.study.axes import Axis, axes_of, cell_medians, named, pairs_of, parameters_of, point_medians
from ndob_fmu.study.plan import read_plan
from ndob_fmu.study.store import read_runs

_MOST_LINES = 2000


def draw_figures(folder: Path) -> list[Path]:
    """Write parallel_coordinates.png of a study's folder, and heat_map.png or scatter.png of two parameters,
    all also as .svg; return the .png files.

    A parameter that is drawn makes a scatter plot: cells of a heat map would hold a run or two each. Where nothing
    varies, or no measure has a value, there is none. Raises UsageError if there is no finished run or a file cannot be
    written.
    """
    plan, table = read_plan(folder), read_runs(folder)
    units = {name: unit.replace(".", "·") for name, unit in plan["units"].items()}
    parameters = parameters_of(plan, table)
    measures = axes_of(table, list(plan["measures"]))
    measures = [axis for axis in measures if np.isfinite(axis.values).any()]
    if not parameters or not measures:
        return []
    paths = [folder / "parallel_coordinates.png"]
    _parallel_coordinates(paths[0], parameters, measures, units)
    if len(parameters) > 1:
        x, y = pairs_of(parameters)[0]
        name, shown = ("scatter", _scatter) if x.drawn or y.drawn else ("heat_map", _heat_map)
        paths.append(folder / f"{name}.png")
        shown(paths[1], x, y, measures[:4], units)
    return paths


def _norm(axis: Axis) -> Normalize:
    known = axis.values[np.isfinite(axis.values)]
    return (LogNorm if axis.log else Normalize)(known.min(), known.max())


def _heat_map(path: Path, x: Axis, y: Axis, measures: Sequence[Axis], units: dict[str, str]) -> None:
    with plots.figure(path, 1, len(measures), height=3.8, width=max(7.0, 4.6 * len(measures))) as panels:
        for axes, measure in zip(panels, measures, strict=True):
            cells, x_labels, y_labels = cell_medians(x, y, measure)
            shown = axes.imshow(
                cells, origin="lower", aspect="auto", norm=_norm(Axis(measure.name, cells)), cmap="viridis"
            )
            axes.set_xticks(range(len(x_labels)), x_labels, rotation=45, ha="right")
            axes.set_yticks(range(len(y_labels)), y_labels)
            axes.grid(visible=False)
            axes.set_xlabel(named(x, units))
            axes.set_ylabel(named(y, units))
            axes.set_title(f"median of {measure.name}")
            axes.figure.colorbar(shown, ax=axes, label=named(measure, units))


def _scatter(path: Path, x: Axis, y: Axis, measures: Sequence[Axis], units: dict[str, str]) -> None:
    with plots.figure(path, 1, len(measures), height=3.8, width=max(7.0, 4.6 * len(measures))) as panels:
        for axes, measure in zip(panels, measures, strict=True):
            across, up, values = point_medians(x, y, measure)
            known = np.isfinite(values)
            axes.plot(across[~known], up[~known], "x", color="0.4", markersize=4, label="no value")
            size = max(4.0, min(30.0, 6000.0 / len(across)))
            norm = _norm(Axis(measure.name, values))
            shown = axes.scatter(across[known], up[known], c=values[known], s=size, norm=norm, cmap="viridis")
            for axis, turn, place in ((x, axes.set_xscale, axes.set_xticks), (y, axes.set_yscale, axes.set_yticks)):
                if axis.log:
                    turn("log")
                if axis.words:
                    place(range(len(axis.words)), axis.words)
            axes.set_xlabel(named(x, units))
            axes.set_ylabel(named(y, units))
            axes.set_title(f"median of {measure.name}")
            if not known.all():
                axes.legend(loc="best", fontsize="x-small", frameon=True)
            axes.figure.colorbar(shown, ax=axes, label=named(measure, units))


def _parallel_coordinates(
    path: Path, parameters: Sequence[Axis], measures: Sequence[Axis], units: dict[str, str]
) -> None:
    everything = [*parameters, *measures]
    places = np.arange(len(everything), dtype=np.float64)
    with plots.figure(path, 1, height=3.8, width=max(7.0, 2.0 * len(everything))) as (axes,):
        heights = np.column_stack([_scale(axes, place, axis) for place, axis in zip(places, everything, strict=True)])
        chosen = np.linspace(0, len(heights) - 1, min(len(heights), _MOST_LINES)).astype(int)
        lines = LineCollection(
            [np.column_stack([places, heights[run]]) for run in chosen], cmap="viridis", norm=_norm(measures[0])
        )
        lines.set_array(measures[0].values[chosen])
        lines.set_alpha(max(0.15, min(0.9, 60 / len(chosen))))
        lines.set_linewidth(1.0)
        axes.add_collection(lines)
        axes.set_xlim(-0.1, places[-1] + 0.1)
        axes.set_ylim(-0.03, 1.03)
        axes.set_yticks([])
        axes.grid(visible=False)
        axes.spines["left"].set_visible(False)
        labels = [named(axis, units).replace(".", ".\n", 1).replace(" [", "\n[") for axis in everything]
        axes.set_xticks(places, labels, fontsize="small")
        colors = mpl.cm.ScalarMappable(norm=_norm(measures[0]), cmap="viridis")  # the lines' own is transparent
        axes.figure.colorbar(colors, ax=axes, label=named(measures[0], units))


def _scale(axes: Axes, place: float, axis: Axis) -> Array:
    """Draw one axis and return the height of each run on it, from 0 to 1."""
    values, ticks, labels = axis.drawable()
    norm = Normalize(ticks[0], ticks[-1])
    axes.axvline(place, color="0.3", linewidth=0.8)
    for height, label in zip(np.asarray(norm(ticks)), labels, strict=True):
        axes.text(place + 0.03, float(height), label, fontsize="x-small", va="center")
    return np.asarray(norm(values), dtype=np.float64)
