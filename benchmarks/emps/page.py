"""The page of the measured record: its table, its figures, and the text around them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure as Drawing

from benchmarks.emps.model import model
from benchmarks.emps.record import AFTER, BEFORE, FORCE, Estimate, known_online, score
from benchmarks.estimator.page import save_flat
from ndob_fmu.log.fit.fit_log import Fitted
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.files import atomic_path

PAGE, WHOLE, EDGE = "emps.md", "emps.png", "emps_edge.png"
TITLE = "Measured record of a positioning drive (EMPS)"
FREE = ("mass", "viscous", "coulomb", "offset")
_STYLE: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}
_COLOURS = ("C0", "C1", "C2", "C3")
_AROUND = (0.01, 0.03)  # s before and after the edge that is shown


def table(t: Array, found: Sequence[Estimate]) -> str:
    """Return the table of the errors of all estimates."""
    lines = ["| estimate | RMS error | away from the edges | within 2·std |", "|---|---|---|---|"]
    for one in found:
        judged = score(t, one)
        lines.append(f"| {one.title} | {judged.rms:.1f} N | {judged.away:.1f} N | {judged.covered:.0%} |")
    return "\n".join(lines)


def fitted_table(fitted: Fitted) -> str:
    """Return the table of what `fit` found, beside what it was told."""
    rows = [("position_noise_std", model.noise_std["position"], fitted.noise_std["position"], "m")]
    rows += [
        (name, model.parameters[name], told, model.units[name].replace(".", "·"))
        for name, told in fitted.parameters.items()
    ]
    lines = ["| | told | found |", "|---|---|---|"]
    lines += [
        f"| `{name}` | {was:.4g} {unit} | {one.value:.4g} ± {2.0 * one.std:.2g} {unit} |"
        for name, was, one, unit in rows
    ]
    rate = fitted.start_values["disturbance_rate"]
    lines.append(f"| `disturbance_order`, `disturbance_rate` | | {fitted.order}, {rate:.3g} N/s |")
    return "\n".join(lines)


def map_table(fitted: Fitted) -> str:
    """Return the table of what the maps explain."""
    lines = [
        "| the part of the disturbance that depends on | share of its mean square | RMS without | RMS with |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {', '.join(one.depends_on)} | {one.explained:.0%} | {one.rms_without:.2f} N | {one.rms_with:.2f} N |"
        for one in fitted.maps.values()
    ]
    return "\n".join(lines)


def draw_whole(t: Array, found: Sequence[Estimate]) -> Drawing:
    """Draw the force and its smoothed estimate over the record, and the errors of all estimates below."""
    with mpl.rc_context(_STYLE):
        drawing = Drawing(figsize=(9.0, 4.4), layout="constrained")
        upper, lower = drawing.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (1.6, 1.1)})
        upper.plot(t, found[-1].true, "k", linewidth=1.4, label="made force")
        upper.plot(t, found[-1].value, "C3", linewidth=0.9)
        upper.set_ylabel("force [N]")
        for one, colour in zip(found, _COLOURS, strict=True):
            lower.plot(t, one.value - one.true, colour, linewidth=0.7, label=one.title)
        lower.set_ylim(-30.0, 30.0)
        lower.set_ylabel("error [N]")
        lower.set_xlabel("t [s]")
        drawing.legend(loc="outside upper center", ncols=5, frameon=False)
    return drawing


def draw_edge(t: Array, found: Sequence[Estimate]) -> Drawing:
    """Draw all estimates with their error bars around the middle edge, at the time that each is for."""
    true = found[0].true
    edges = t[1:][np.diff(true) != 0.0]
    edge = float(edges[len(edges) // 2])
    with mpl.rc_context(_STYLE):
        drawing = Drawing(figsize=(9.0, 3.2), layout="constrained")
        panels = drawing.subplots(1, len(found), sharey=True)
        for axes, one, colour in zip(panels, found, _COLOURS, strict=True):
            # The lag, if it has one, is taken off, so that the edges lie below one another.
            own = t[1:][np.diff(one.true) != 0.0]
            ms = 1e3 * (t - own[len(edges) // 2])
            seen = (ms >= -1e3 * _AROUND[0]) & (ms <= 1e3 * _AROUND[1])
            value, two_std = one.value[seen], 2.0 * one.std[seen]
            axes.fill_between(ms[seen], value - two_std, value + two_std, color=colour, alpha=0.2, linewidth=0)
            axes.step(ms[seen], one.true[seen], "k", linewidth=1.4, where="post")
            axes.plot(ms[seen], value, f"{colour}.-", linewidth=0.9, markersize=3)
            axes.set_title(one.title, fontsize=9)
            axes.set_ylim(-1.5 * FORCE, 1.5 * FORCE)
        drawing.axes[0].set_ylabel("force [N]")
        drawing.supxlabel(f"time from the edge at {edge:.2f} s [ms]", fontsize=9)
    return drawing


def write(folder: Path, fitted: Fitted, t: Array, found: Sequence[Estimate]) -> list[Path]:
    """Write page and figures into the folder and return their paths."""
    for name, drawing in ((WHOLE, draw_whole(t, found)), (EDGE, draw_edge(t, found))):
        with atomic_path(folder / name) as temporary:
            save_flat(drawing, temporary)
    text = _TEXT.format(
        title=TITLE,
        whole=WHOLE,
        edge=EDGE,
        free=" ".join(FREE),
        force=FORCE,
        volt=FORCE / model.parameters["gain"],
        gain=model.parameters["gain"],
        count=np.count_nonzero(np.diff(found[0].true)),
        before=1e3 * BEFORE,
        after=1e3 * AFTER,
        stop=t[-1] - t[0],
        rows=len(t),
        errors=table(t, found),
        least_at=score(t, known_online(found[0], 1)).rms,
        least_next=score(t, known_online(found[1], 2)).rms,
        fitted=fitted_table(fitted),
        maps=map_table(fitted),
        warnings="".join(f"\n> {line}\n" for line in fitted.warnings),
    )
    with atomic_path(folder / PAGE) as temporary:
        temporary.write_text(text, "utf-8", newline="\n")
    return [folder / name for name in (PAGE, WHOLE, EDGE)]


_TEXT = """\
# {title}

<!-- Written by `python -m benchmarks.emps`; changes belong there. -->

![The made force, its smoothed estimate and the errors]({whole})

A motor drives a load along a linear guide by a spindle. Janot, Gautier and Brunot measured the record, {stop:.1f} s in
{rows} rows, on a real drive in closed loop. Its friction is not exactly that of the equations below.

**Measured**: the position, by an encoder, every millisecond. **Known**: the voltage of the current loop. **Unknown**: a
force on the load.

What acts on a real drive is not known. So a known force is made: pulses of {force:g} N at random times with random
signs, {count} edges. They are subtracted from the voltage that the observer is told, as {volt:.2f} V with {gain:g} N/V.
The drive has moved as if an unknown force had acted in place of that voltage. Errors of the model, such as friction
that depends on the place, are not a part of this force; they count as errors of the estimate.

## From the record to the estimate

The script finds noise, pace and parameters by `fit` in the record as it was measured, without pulses. Then
`estimate` runs over the record with the pulses, with what was found:

    python -m benchmarks.emps DATA_EMPS.mat

It does the same as these commands; measured.csv is the record, and in pulses.csv the voltage lacks the pulses:

    ndob-fmu fit benchmarks/emps/model.py measured.csv --free {free} --start-values lag 0.02 --out results/fit
    ndob-fmu estimate benchmarks/emps/model.py pulses.csv --start-values-file results/fit/fit.json

{fitted}

The model says that a part of the force is a function of the velocity, as friction, and of the position. `fit` learns
that part. Of tenths of the record that were left out, it explains:

{maps}

What `fit` says besides:
{warnings}
## Figures

{errors}

The first 0.2 s are not judged. "Away from the edges" leaves out {before:g} ms before an edge and {after:g} ms after it.
"At the sample" is the estimate from all samples so far (`force_at_sample`), "for the next sample" the prediction that
a controller has when the next sample comes (`force_hat`). No online estimate can know a jump before samples show it:
an edge moves the position from the next sample on. One row at each edge alone makes {least_at:.1f} N at the sample, two
rows make {least_next:.1f} N in the prediction. Later samples show where the jump was. What is left is an error of the
model: ripple of the spindle, and friction when the drive turns. The observer finds this force too. It is not in the
made one. `fit` chooses the rate of the disturbance so high that all bands hold it. `fit` has seen the same record,
without pulses; a record of another day would be a harder test.

![Each estimate with its error bar around an edge]({edge})

Each column is shown at the time that its estimate is for. The band is ± 2·std.

## Equations

```{{literalinclude}} ../../benchmarks/emps/model.py
:language: python
:pyobject: dynamics
```

## Source of the data

A. Janot, M. Gautier and M. Brunot, *Data set and reference models of EMPS*, Workshop on Nonlinear System Identification
Benchmarks, Eindhoven, 2019; at [nonlinearbenchmark.org](https://www.nonlinearbenchmark.org). The data are not a part of
this repository. The parameters that are told are theirs.
"""
