"""The figures of a study: two parameters with a measure as colour, and parallel coordinates over all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from numpy.typing import NDArray

from ndob_fmu.results import plots
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.study.plan import read_plan
from ndob_fmu.study.store import column, read_runs

_MOST_CELLS = 12  # along an axis of the heat map
_MOST_LINES = 2000
_FEW = 6  # ticks
_LOG_FROM = 20.0  # the ratio of largest to smallest from which an axis of positive values is logarithmic


@dataclass(frozen=True)
class Axis:
    """One parameter or measure over the runs, (runs,): numbers as they are, words numbered by ``words``.

    drawn: by a Latin hypercube or at random, so that every run has a value of its own.
    """

    name: str
    values: Array
    words: tuple[str, ...] = ()
    drawn: bool = False

    @property
    def log(self) -> bool:
        """Whether its finite values are positive and span decades."""
        known = self.values[np.isfinite(self.values)]
        return not self.words and len(known) > 0 and bool(known.min() > 0 and known.max() / known.min() >= _LOG_FROM)

    def cells(self) -> tuple[NDArray[np.intp], list[str]]:
        """Return the cell of each run along the axis, and a label for each cell."""
        levels = np.unique(self.values[np.isfinite(self.values)])
        if len(levels) <= _MOST_CELLS:
            return np.searchsorted(levels, self.values), [self.label(level) for level in levels]
        scale = np.geomspace if self.log else np.linspace
        edges = scale(levels[0], levels[-1], _MOST_CELLS + 1)
        inside = np.clip(np.searchsorted(edges, self.values, side="right") - 1, 0, _MOST_CELLS - 1)
        return inside, [f"{a:.3g} – {b:.3g}" for a, b in pairwise(edges)]

    def label(self, value: float) -> str:
        """Return a value as text."""
        return self.words[int(value)] if self.words else f"{value:.3g}"

    def drawable(self) -> tuple[Array, list[float], list[str]]:
        """Return the values at which to draw each run, logarithmic where they span decades, and ticks with labels.

        What is not finite, as the settling time of what never settles, lies above the rest, at a tick of its own.
        """
        finite = np.isfinite(self.values)
        known = self.values[finite]
        levels = np.unique(known)
        spread = np.geomspace if self.log else np.linspace
        marks = levels if self.words or len(levels) <= _FEW else spread(known.min(), known.max(), _FEW)
        labels = [self.label(mark) for mark in marks]
        ticks, values = (np.log10(marks), np.log10(self.values)) if self.log else (marks, self.values)
        if not finite.all():
            above = ticks[-1] + 0.12 * (np.ptp(ticks) or 1.0)
            values = np.where(finite, values, above)
            ticks, labels = np.append(ticks, above), [*labels, "none"]
        return values, [float(tick) for tick in ticks], labels


def parameters_of(plan: Mapping[str, Any], table: pa.Table) -> list[Axis]:
    """Return the parameters that differ between the finished runs."""
    axes = axes_of(table, list(plan["varied"]))
    drawn = {name for name, how in plan["varied"].items() if isinstance(how, dict)}
    return [replace(axis, drawn=axis.name in drawn) for axis in axes if len(np.unique(axis.values)) > 1]


def axes_of(table: pa.Table, names: Sequence[str]) -> list[Axis]:
    """Return the named columns as axes."""
    return [_axis(name, column(table, name)) for name in names]


def _axis(name: str, values: NDArray[Any]) -> Axis:
    if values.dtype.kind in "iuf":
        return Axis(name, values.astype(np.float64))
    words = tuple(dict.fromkeys(map(str, values)))
    return Axis(name, np.array([words.index(str(value)) for value in values], dtype=np.float64), words)


def cell_medians(x: Axis, y: Axis, z: Axis) -> tuple[Array, list[str], list[str]]:
    """Return the median of z in each cell, (cells of y, cells of x), NaN where there is none, and the cells' labels."""
    columns, x_labels = x.cells()
    rows, y_labels = y.cells()
    cells = np.full((len(y_labels), len(x_labels)), np.nan)
    for row, col in set(zip(rows.tolist(), columns.tolist(), strict=True)):
        values = z.values[(rows == row) & (columns == col)]
        if np.isfinite(values).any():
            cells[row, col] = np.median(values[np.isfinite(values)])
    return cells, x_labels, y_labels


def point_medians(x: Axis, y: Axis, z: Axis) -> tuple[Array, Array, Array]:
    """Return each point (x, y) of the runs once, (points,) both, and the median of z there, NaN where there is none.

    Each point of a Latin hypercube comes again with each combination of a grid.
    """
    runs = np.column_stack([x.values, y.values])
    places, owner, counts = np.unique(runs, axis=0, return_inverse=True, return_counts=True)
    of_place = np.split(z.values[np.argsort(owner.ravel(), kind="stable")], np.cumsum(counts)[:-1])
    known = [values[np.isfinite(values)] for values in of_place]
    medians = np.array([np.median(values) if len(values) else np.nan for values in known])
    return places[:, 0], places[:, 1], medians


def pairs_of(parameters: Sequence[Axis]) -> list[tuple[Axis, Axis]]:
    """Return all pairs of parameters, those that are drawn first: they have more than a few levels."""
    pairs = [(x, y) for k, x in enumerate(parameters) for y in parameters[k + 1 :]]
    return sorted(pairs, key=lambda pair: -(pair[0].drawn + pair[1].drawn))


def draw(folder: Path) -> list[Path]:
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


def named(axis: Axis, units: dict[str, str]) -> str:
    """Return the name with its unit."""
    return f"{axis.name} [{units[axis.name]}]" if units.get(axis.name) else axis.name


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
