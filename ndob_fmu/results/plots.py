"""The figures of a run: disturbance and estimate, state error, and what the schedule of π prevents."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ndob_fmu.errors import UsageError
from ndob_fmu.results.recording import Recording
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.files import atomic_path

# How far a logarithmic axis reaches from the typical value, at most.
_DECADES_BELOW, _DECADES_ABOVE = 4, 8
_STYLE: Any = {
    "font.size": 10,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "savefig.dpi": 150,
    "svg.fonttype": "none",  # text stays text, which a paper's editor can change
    "svg.hashsalt": "ndob-fmu",  # the same figure gives the same bytes
}


def plot_disturbance(
    path: Path, time: Array, true: Array, estimate: Array, *, label: str, error_label: str, settled_at: float | None
) -> None:
    """Write figure 1: the disturbance and its estimate over time in s, and below it the size of their difference."""
    with figure(path, rows=2) as (above, below):
        above.plot(time, true, "k--", linewidth=1.2, label="true")
        above.plot(time, estimate, color="C0", label="estimate")
        above.set_ylabel(label)
        if settled_at is not None:
            above.axvline(settled_at, color="C2", linewidth=1, label=f"within 2 % from {settled_at:.2f} s")
        above.legend(loc="lower right")
        above.set_title("Disturbance and its estimate")
        _log_magnitude(below, time, estimate - true)
        below.set_ylabel(error_label)
        below.set_xlabel("time [s]")


def plot_state_error(path: Path, time: Array, error_norm: Array) -> None:
    """Write figure 2: the norm of the state's estimation error, linear above and logarithmic below."""
    with figure(path, rows=2) as (above, below):
        above.plot(time, error_norm, color="C1")
        above.set_ylabel("‖x − x̂‖")
        above.set_title("Norm of the state estimation error")
        _log_magnitude(below, time, error_norm, color="C1")
        below.set_ylabel("‖x − x̂‖")
        below.set_xlabel("time [s]")


def plot_peaking(path: Path, scheduled: tuple[Array, Array], at_once: tuple[Array, Array], *, label: str) -> None:
    """Write figure 3: |d̂| with π raised along its schedule and with its final value from the start."""
    with figure(path, rows=1) as (axes,):
        for (time, estimate), text, color in (
            (at_once, "final π from the start", "C3"),
            (scheduled, "π raised along the schedule", "C0"),
        ):
            peak = float(np.max(np.abs(estimate)))
            axes.semilogy(time, np.maximum(np.abs(estimate), 1e-3), color=color, label=f"{text}: peak {peak:.3g}")
        # Linear up to the first step, so that the peak at t = 0 is on the axis.
        axes.set_xscale("symlog", linthresh=float(at_once[0][1]), linscale=0.3)
        axes.set_xlim(0.0, float(at_once[0][-1]))
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"|{label}|")
        axes.set_title("Peaking that the schedule of π avoids")
        axes.legend(loc="upper right")


def plot_start_up(path: Path, errors: Mapping[str, tuple[Array, Array]], *, label: str) -> None:
    """Write figure 4: |d̂ − d| from the first step on, each entry (time in s, error) under its name."""
    with figure(path, rows=1) as (axes,):
        for (text, (time, error)), color in zip(errors.items(), ("C3", "C0", "C2"), strict=True):
            axes.loglog(time[1:], np.maximum(error[1:], 1e-12), color=color, label=text)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"|{label}|")
        axes.set_title("How long the estimate takes from a wrong start")
        axes.legend(loc="upper right")


def plot_signals(path: Path, recording: Recording) -> None:
    """Write a figure of every signal over time in s, one panel for each component and unit.

    The Booleans of a component have a panel of their own, because one that often changes would hide the other signals.
    """
    panels = _panels(recording)
    with figure(path, len(panels), height=1.0 + 1.8 * len(panels)) as rows:
        _draw(rows, panels, recording)


def show(recording: Recording) -> None:
    """Open a window with every signal over time in s, one panel for each component and unit.

    Raises UsageError where there is no screen.
    """
    import matplotlib.pyplot as plt  # only here: it looks for a screen

    if plt.get_backend().lower() == "agg":
        raise UsageError.report(
            "--show-plot", expected="a screen", received="none", likely="`--results DIR` writes the figure to a file"
        )
    panels = _panels(recording)
    with mpl.rc_context(_STYLE):
        _, rows = plt.subplots(
            len(panels), squeeze=False, sharex=True, figsize=(9.0, min(9.0, 1.0 + 1.8 * len(panels)))
        )
        _draw(rows[:, 0], panels, recording)
        plt.show()


def _panels(recording: Recording) -> dict[tuple[str, str], list[str]]:
    """Return the signals of each component and label of the axis, in the order of the recording."""
    panels: dict[tuple[str, str], list[str]] = {}
    for name, fmi_type in zip(recording.names, recording.types, strict=True):
        component = name.partition(".")[0] if "." in name else ""
        unit = "Boolean" if fmi_type == "Boolean" else recording.units.get(name, "").replace(".", "·") or "1"
        panels.setdefault((component, f"{component} [{unit}]"), []).append(name)
    return panels


def _draw(rows: Iterable[Axes], panels: Mapping[tuple[str, str], Sequence[str]], recording: Recording) -> None:
    for axes, ((component, label), names) in zip(rows, panels.items(), strict=True):
        for name in names:
            axes.plot(recording.time, recording[name], linewidth=1.0, label=name.removeprefix(f"{component}."))
        axes.set_ylabel(label)
        axes.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    axes.set_xlabel("time [s]")


def decades(values: Array) -> tuple[float, float] | None:
    """Return the range of a logarithmic axis, as exponents of ten, around the typical value; None if there is none.

    It reaches up to the largest value unless that is out of all proportion, and down four decades: a start that is
    exact by construction or a difference that happens to be 1e-16 does not set the scale.
    """
    known = np.abs(values[np.isfinite(values) & (values != 0.0)])
    if not len(known):
        return None
    typical = math.log10(float(np.median(known)))
    low = max(math.log10(float(known.min())), typical - _DECADES_BELOW)
    high = min(math.log10(float(known.max())), typical + _DECADES_ABOVE)
    return math.floor(low), max(math.ceil(high), math.floor(low) + 1)


def _log_magnitude(axes: Axes, time: Array, value: Array, color: str = "C0") -> None:
    size = np.abs(value)
    axes.semilogy(time, np.where(size > 0.0, size, np.nan), color=color)
    limits = decades(value)
    if limits is not None:
        axes.set_ylim(10.0 ** limits[0], 10.0 ** limits[1])


@contextmanager
def figure(
    path: Path, rows: int, columns: int = 1, *, width: float = 7.0, height: float | None = None
) -> Iterator[list[Axes]]:
    """Give axes, row by row, to draw into; write them as ``path``, a .png, and beside it as .svg.

    width, height: in inches. Raises UsageError if a file cannot be written.
    """
    with mpl.rc_context(_STYLE):
        tall = 2.4 + 2.0 * (rows - 1) + (1.0 if rows == 1 else 0.4) if height is None else height
        drawn = Figure(figsize=(width, tall))
        axes = drawn.subplots(rows, columns, squeeze=False, sharex=columns == 1)
        yield list(axes.flat)
        for suffix, metadata in ((".png", {"Software": None}), (".svg", {"Date": None})):
            with atomic_path(path.with_suffix(suffix)) as temporary:
                drawn.savefig(temporary, metadata=metadata)
            drawn.set_layout_engine("none")  # that of the first file, which takes as long as drawing, is that of both
