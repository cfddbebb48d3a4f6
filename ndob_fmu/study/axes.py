"""Parameters and measures over the runs of a study as axes, and the medians of a measure over two of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.study.store import column

_MOST_CELLS = 12  # along an axis of the heat map
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


def named(axis: Axis, units: dict[str, str]) -> str:
    """Return the name with its unit."""
    return f"{axis.name} [{units[axis.name]}]" if units.get(axis.name) else axis.name
