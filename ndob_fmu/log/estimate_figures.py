"""The figures of an estimated log: each disturbance with its bands, and the residuals of each output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from ndob_fmu.log.diagnostics import LAGS, OutputDiagnosis
from ndob_fmu.log.result_table import LOG, OBSERVER, SMOOTHER
from ndob_fmu.results import plots
from ndob_fmu.results.recording import Recording
from ndob_fmu.results.shown_time import ShownTime
from ndob_fmu.results.thinning import thinned
from ndob_fmu.runtime.arrays import Array

# Points of a line: more cannot be seen.
_POINTS = 20_000
# Characters that fit beside an axis.
_LABEL = 24


class Thinned:
    """Every k-th row of a recording that comes in parts, with k such that a figure can show them."""

    def __init__(self) -> None:
        self._every, self._skip, self._parts = 1, 0, [np.empty((0, 0))]
        self._names: tuple[str, ...] = ()

    def add(self, part: Recording) -> Recording:
        """Keep some rows of a part, and return it."""
        rows = np.column_stack([part.time, part.columns])
        kept = rows[self._skip :: self._every]
        self._skip = (self._skip - len(rows)) % self._every
        self._parts = [*(p for p in self._parts if p.size), kept]
        self._names = part.names
        if sum(map(len, self._parts)) > _POINTS:
            whole = np.concatenate(self._parts)
            # The next row that is kept lies two old distances behind the last one of these.
            self._skip += self._every if len(whole) % 2 else 0
            self._parts, self._every = [whole[::2]], 2 * self._every
        return part

    def __getitem__(self, name: str) -> Array:
        """Return the kept values of a signal, or of ``time``."""
        column = 0 if name == "time" else 1 + self._names.index(name)
        return np.concatenate([part[:, column] for part in self._parts])


def write_figures(
    folder: Path,
    kept: Thinned,
    disturbances: Sequence[tuple[str, str]],
    outputs: Sequence[tuple[str, str]],
    diagnoses: Mapping[str, OutputDiagnosis],
    shown: ShownTime,
    *,
    smooths: bool,
) -> None:
    """Write fig1_disturbance.png, fig2_outputs.png and fig3_residuals.png.

    disturbances, outputs: names and units
    """
    time = shown.of(kept["time"])
    with plots.figure(folder / "fig1_disturbance.png", rows=len(disturbances)) as rows:
        for axes, (name, unit) in zip(rows, disturbances, strict=True):
            lines = [(OBSERVER, f"{name}_hat", f"{name}_std", "online", "C0")]
            lines += [(SMOOTHER, name, f"{name}_std", "smoothed", "C3")] if smooths else []
            ends: list[Array] = []
            drawn: dict[str, tuple[Any, ...]] = {}
            for component, mean, std, label, color in lines:
                value, bar = kept[f"{component}.{mean}"], 2.0 * kept[f"{component}.{std}"]
                line, band = _line(axes, time, value, color), _band(axes, time, value - bar, value + bar, color, 0.15)
                drawn[f"{label}, ± 2 std"] = (band, line)
                ends += [value - bar, value + bar]
            _show_usual(axes, ends)
            _label(axes, name, f"[{unit}]")
        _legend(rows[0], drawn)
        axes.set_xlabel(shown.label)
    with plots.figure(folder / "fig2_outputs.png", rows=2 * len(outputs)) as rows:
        for i, (name, unit) in enumerate(outputs):
            above, below = rows[2 * i], rows[2 * i + 1]
            # A residual stands in the row behind that of its sample.
            sample, residual = kept[f"{LOG}.{name}"], kept[f"{OBSERVER}.{name}_residual"]
            bar = 2.0 * kept[f"{OBSERVER}.{name}_residual_std"]
            _line(above, time, sample, "C0")
            _label(above, name, f"[{unit}]")
            # Thousands of dots are slow in a vector file, to write and to look at.
            (dots,) = below.plot(time, residual, ".", markersize=1.5, color="C1", rasterized=True)
            band = _band(below, time, -bar, bar, "0.5", 0.25)
            _show_usual(below, [residual, -bar, bar])
            _label(below, "residual", f"[{unit}]")
        _legend(rows[1], {"sample less its prediction": (dots,), "± 2 std": (band,)})
        below.set_xlabel(shown.label)
    with plots.figure(folder / "fig3_residuals.png", rows=len(outputs)) as rows:
        for axes, (name, found) in zip(rows, diagnoses.items(), strict=True):
            bars = axes.bar(np.arange(1, LAGS + 1), found.correlation, color="C0", width=0.6)
            edge = found.correlation_band
            chance = axes.axhspan(-edge, edge, color="0.5", alpha=0.25, linewidth=0.0)
            axes.set_ylim(-1.0, 1.0)
            _label(axes, name)
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        _legend(rows[0], {"correlation of residuals": (bars,), "by chance, 95 %": (chance,)})
        axes.set_xlabel("samples apart")


def _line(axes: Axes, time: Array, value: Array, color: str) -> Line2D:
    """Draw a signal, of which a figure shows no more than `thinned` leaves."""
    rows = thinned(value)
    (line,) = axes.plot(time[rows], value[rows], color=color, linewidth=1.0)
    return line


def _band(axes: Axes, time: Array, low: Array, high: Array, color: str, alpha: float) -> PolyCollection:
    """Draw a band, of which a figure shows no more than `thinned` leaves."""
    rows = np.union1d(thinned(low), thinned(high))
    return axes.fill_between(time[rows], low[rows], high[rows], color=color, alpha=alpha, linewidth=0.0)


def _label(axes: Axes, name: str, unit: str = "") -> None:
    """Label the axis of a value; a long label has two lines, or smaller letters, to stay beside its axis."""
    line = f"{name} {unit}".rstrip()
    lines = [line] if len(line) <= _LABEL else [name, unit]
    small = min(1.0, _LABEL / max(map(len, lines)))
    axes.set_ylabel("\n".join(filter(None, lines)), fontsize=small * mpl.rcParams["font.size"])


def _legend(axes: Axes, drawn: Mapping[str, tuple[Any, ...]]) -> None:
    """Write a legend above an axis, where it hides no curve."""
    axes.legend(
        [*drawn.values()],
        [*drawn],
        ncols=len(drawn),
        markerscale=5.0,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        borderaxespad=0.2,
    )


def _show_usual(axes: Axes, signals: Sequence[Array]) -> None:
    """Let an axis show the usual values of signals: at the start, bars are as wide as the state is unknown."""
    low, high = (np.nanquantile(np.concatenate(signals), share) for share in (0.005, 0.995))
    room = 0.1 * (high - low) or 1.0
    axes.set_ylim(low - room, high + room)
