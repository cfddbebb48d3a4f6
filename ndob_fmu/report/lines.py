"""The parts of a figure over time: lines, bands, shaded spans and axes with units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from ndob_fmu.report.signals import spans
from ndob_fmu.results.plots import decades
from ndob_fmu.results.thinning import thinned
from ndob_fmu.runtime.arrays import Array

# Told apart in print without colours too: what is true is dashed and black, a band is a light shade.
TRUTH = {"color": "#222222", "dash": "dash", "width": 1.4}
ESTIMATE = {"color": "#1f5fa8", "width": 1.6}
ERROR = {"color": "#b3361e", "width": 1.1}
MEASURED = {"color": "#8a94a0", "width": 1.2}
_BAND = "rgba(31, 95, 168, 0.18)"
_INVALID = "rgba(214, 120, 0, 0.16)"

LAYOUT: dict[str, Any] = {
    "template": "plotly_white",
    "margin": {"l": 80, "r": 20, "t": 50, "b": 50},
    "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    "hovermode": "x unified",
    "font": {"size": 13, "color": "#1c2530"},
}


class Panels:
    """One figure of panels over the same time, from the top to the bottom; heights: their shares."""

    def __init__(self, heights: Sequence[float]) -> None:
        self.figure = make_subplots(
            rows=len(heights), cols=1, shared_xaxes=True, vertical_spacing=0.07, row_heights=list(heights)
        )
        self.figure.update_layout(LAYOUT, height=130 + int(230 * sum(heights)), showlegend=True)
        self.figure.update_yaxes(exponentformat="power", tickfont={"size": 12}, zeroline=False)
        self.figure.update_xaxes(title_text="time [s]", row=len(heights), col=1)

    def line(self, panel: int, time: Array, values: Array, name: str, style: dict[str, Any] | None = None) -> None:
        """Draw a signal (rows,); what is not finite is a gap."""
        rows = thinned(values)
        self.figure.add_scatter(
            x=_compact(time[rows], _step(time)),
            y=_compact(values[rows], _finest(values)),
            name=name,
            mode="lines",
            line=style or {"width": 1.4},
            row=panel,
            col=1,
        )

    def band(self, panel: int, time: Array, low: Array, high: Array, name: str, *, edge: bool = False) -> None:
        """Shade what lies between two signals (rows,), except where one of them is not finite.

        edge: with lines around it, for a band that is drawn over a noisy signal.
        """
        rows = np.union1d(thinned(low), thinned(high))
        usable = np.isfinite(low[rows]) & np.isfinite(high[rows])
        x: list[float | None] = []
        y: list[float | None] = []
        for part in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(usable)) + 1):
            if usable[part[0]]:
                own = rows[part]
                x += [None] * bool(x) + [*time[own].tolist(), *time[own][::-1].tolist()]
                y += [None] * bool(y) + [*_rounded(high[own]), *_rounded(low[own])[::-1]]
        self.figure.add_scatter(
            x=x,
            y=y,
            name=name,
            mode="lines",
            fill="toself",
            fillcolor=_BAND,
            line={"width": 1.0, "color": ESTIMATE["color"]} if edge else {"width": 0.5, "color": _BAND},
            hoverinfo="skip",
            row=panel,
            col=1,
        )

    def magnitude(self, panel: int, label: str, *signals: Array) -> None:
        """Make an axis logarithmic, around the typical value of the first of the signals that are drawn in it."""
        axis: dict[str, Any] = {"title_text": label, "type": "log"}
        found = [limits for limits in map(decades, signals) if limits is not None]
        if found:
            axis["range"] = [found[0][0], max(found[0][1], *(high for _, high in found))]
            axis["dtick"] = max(1, round((axis["range"][1] - axis["range"][0]) / 5))
        self.figure.update_yaxes(**axis, row=panel, col=1)

    def axis(self, panel: int, label: str, limits: tuple[float, float] | None = None) -> None:
        """Label an axis; limits: where it is not to show everything at first."""
        self.figure.update_yaxes(title_text=label, row=panel, col=1, **({"range": list(limits)} if limits else {}))

    def shade(self, time: Array, holds: NDArray[np.bool_]) -> None:
        """Shade the steps (rows,) in which the estimate coasted, through all panels."""
        for start, end in spans(time, holds):
            self.figure.add_shape(
                type="rect",
                x0=start,
                x1=end,
                y0=0,
                y1=1,
                yref="paper",
                layer="below",
                fillcolor=_INVALID,
                line={"width": 1, "color": _INVALID},
            )


def magnitude(values: Array) -> Array:
    """Return |values| for a logarithmic axis: 0, which has no place there, is a gap."""
    size = np.abs(values)
    return np.where(size > 0.0, size, np.nan)


def _compact(values: Array, finest: float) -> NDArray[np.floating[Any]]:
    """Return values in single precision, half the file, where that resolves what is `finest` to be told apart."""
    known = np.abs(values[np.isfinite(values)])
    largest = float(known.max()) if len(known) else 0.0
    fits = largest < np.finfo(np.float32).max and np.spacing(np.float32(largest)) <= finest
    return values.astype(np.float32) if fits else values


def _finest(values: Array) -> float:
    known = values[np.isfinite(values)]
    return 1e-4 * float(np.ptp(known)) if len(known) else 0.0


def _step(time: Array) -> float:
    return 0.05 * float(np.median(np.diff(time))) if len(time) > 1 else 0.0


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.7g}") for value in values]
