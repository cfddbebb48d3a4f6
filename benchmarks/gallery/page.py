"""A page of the gallery: what was measured, the picture, and the text around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure as Drawing

from benchmarks.emps.page import TITLE as EMPS
from benchmarks.estimator.kalman import ekf
from benchmarks.estimator.ours import Estimates, ours_of
from benchmarks.estimator.page import save_flat
from benchmarks.estimator.plants import Array, Plant
from benchmarks.estimator.records import Record, simulate
from benchmarks.estimator.scores import STEADY_FROM
from benchmarks.estimator.tasks import ms
from benchmarks.gallery.exhibits import Exhibit
from ndob_fmu.support.files import atomic_path

OFF = 0.15  # of an uncertain parameter
NOMINAL, UNTOLD, TOLD = "model exact", "parameters 15 % off, not told", "parameters 15 % off, told"


@dataclass(frozen=True)
class Shown:
    """A record with the estimates of ours and of the Kalman filter."""

    record: Record
    ours: Estimates
    filter: Estimates


def measured(plant: Plant, exhibit: Exhibit, seed: int) -> dict[str, Shown]:
    """Return the three cases: the model exact, and its parameters off, without and with `<parameter>_std`."""
    disturbance = exhibit.disturbance(plant)
    step = float(plant.model().experiment.step_size)
    exact = simulate(plant, step, [seed], disturbance)
    off = simulate(plant, step, [seed], disturbance, parameters=_off(plant, exhibit, seed))
    std = {f"{name}_std": OFF * abs(plant.parameters[name]) for name in exhibit.uncertain}
    of_filter = ekf(off)
    return {
        NOMINAL: Shown(exact, ours_of(exact), ekf(exact)),
        UNTOLD: Shown(off, ours_of(off), of_filter),
        TOLD: Shown(off, ours_of(off, **std), of_filter),
    }


def _off(plant: Plant, exhibit: Exhibit, seed: int) -> dict[str, float]:
    """Return the true parameters: each uncertain one is larger or smaller by `OFF`, at random."""
    signs = np.random.default_rng([seed, 2]).choice([-1.0, 1.0], len(exhibit.uncertain))
    return {
        name: plant.parameters[name] * (1.0 + OFF * sign) for name, sign in zip(exhibit.uncertain, signs, strict=True)
    }


# -- numbers


def table(plant: Plant, cases: dict[str, Shown]) -> str:
    """Return the table: for each case and disturbance the RMS error, that of the EKF, coverage and validity."""
    lines = [
        "| record | disturbance | RMS error | in % of D₀ | EKF | within 2·std | EKF within 2·std | `valid` |",
        "|---|---|---|---|---|---|---|---|",
    ]
    model = plant.model()
    for text, shown in cases.items():
        first = int(STEADY_FROM * len(shown.record.t))
        valid = float(np.mean(shown.ours["valid"][:, first:]))
        for i, d in enumerate(model.disturbances):
            unit = model.units[d].replace(".", "·")
            found, other = (_rms(shown.record, e, i, first) for e in (shown.ours, shown.filter))
            error, share, of_other = map(_two_digits, (found, 100.0 * found / plant.bounds[i], other))
            covered, of_filter = (_covered(shown.record, e, i, first) for e in (shown.ours, shown.filter))
            lines.append(
                f"| {text} | `{d}` | {error} {unit} | {share} % | {of_other} {unit} | "
                f"{covered:.1%} | {of_filter:.1%} | {valid:.1%} |"
            )
    return "\n".join(lines)


def _two_digits(value: float) -> str:
    return str(np.format_float_positional(value, precision=2, fractional=False, trim="-"))


def _rms(record: Record, found: Estimates, i: int, first: int) -> float:
    return float(np.sqrt(np.mean((found["at"] - record.d)[:, first:, i] ** 2)))


def _covered(record: Record, found: Estimates, i: int, first: int) -> float:
    error = np.abs(found["ahead"] - record.d_end)[:, first:, i]
    return float(np.mean(error <= 2.0 * found["std"][:, first:, i]))


# -- picture

_STYLE: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}
_HEIGHTS = (1.6, 1.1)  # inches, of a disturbance and of its error
_START = 0.05  # of a record, the errors of which may exceed the axes
_SHOWN = (0.01, 0.99)  # quantiles that the axes show: peaks after a jump may exceed them


def draw(plant: Plant, exhibit: Exhibit, cases: dict[str, Shown]) -> Drawing:
    """Draw each disturbance and its error: on the left with the exact model, on the right with parameters off."""
    names = plant.model().disturbances
    with mpl.rc_context(_STYLE):
        drawing = Drawing(figsize=(9.0, 0.9 + sum(_HEIGHTS) * len(names)), layout="constrained")
        grid = drawing.subplots(
            2 * len(names), 2, sharex=True, squeeze=False, gridspec_kw={"height_ratios": _HEIGHTS * len(names)}
        )
        for i, name in enumerate(names):
            unit, size = exhibit.unit or (plant.model().units[name].replace(".", "·"), 1.0)
            for column, text in enumerate((NOMINAL, TOLD)):
                untold = cases[UNTOLD] if text == TOLD else None
                _draw_case(grid[2 * i : 2 * i + 2, column], cases[text], untold, i, size, exhibit.time[1])
            grid[2 * i, 0].set_ylabel(f"{name} [{unit}]")
            grid[2 * i + 1, 0].set_ylabel(f"error [{unit}]")
        drawing.align_ylabels(grid[:, 0])
        for axes, text in zip(grid[0], (NOMINAL, TOLD), strict=True):
            axes.set_title(text)
        for axes in grid[-1]:
            axes.set_xlabel(f"t [{exhibit.time[0]}]")
        drawing.legend(*grid[0][1].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return drawing


def _draw_case(pair: Array, shown: Shown, untold: Shown | None, i: int, size: float, second: float) -> None:
    """Draw a disturbance with its estimate, and below the error, in units of `size` over units of `second`."""
    record, found = shown.record, shown.ours
    t, end = record.t / second, (record.t + record.steps) / second
    d, at = record.d[:, i] / size, found["at"][0, :, i] / size
    d_hat, two_std = found["ahead"][0, :, i] / size, 2.0 * found["std"][0, :, i] / size
    upper, lower = pair
    late = slice(int(_START * len(t)), None)
    seen = [d, *(np.quantile(line[late], _SHOWN) for line in (d_hat - two_std, d_hat + two_std, at))]
    upper.fill_between(end, d_hat - two_std, d_hat + two_std, color="C3", alpha=0.2, linewidth=0, label="± 2·std")
    if untold is not None:
        alone = untold.ours["at"][0, :, i] / size
        upper.plot(t, alone, "C0", linewidth=0.8, label="estimate, not told")
        seen.append(np.quantile(alone[late], _SHOWN))
    upper.plot(t, at, color="C3", linewidth=1.0, label="estimate")
    upper.plot(t, d, color="black", linewidth=1.4, label="true")
    low, high = np.min(np.concatenate(seen)), np.max(np.concatenate(seen))
    upper.set_ylim(low - 0.06 * (high - low), high + 0.06 * (high - low))
    lower.fill_between(end, -two_std, two_std, color="C3", alpha=0.2, linewidth=0)
    lower.plot(t, at - d, color="C3", linewidth=0.8)
    largest = 1.2 * max(np.quantile(size_of[late], _SHOWN[1]) for size_of in (two_std, np.abs(at - d)))
    lower.set_ylim(-largest, largest)


# -- files


def write(folder: Path, plant: Plant, exhibit: Exhibit, seed: int) -> list[Path]:
    """Write the page of a plant and its picture into the folder and return their paths."""
    cases = measured(plant, exhibit, seed)
    page, picture = folder / f"{plant.name}.md", folder / f"{plant.name}.png"
    with atomic_path(page) as temporary:
        temporary.write_text(_text(plant, exhibit, cases), "utf-8", newline="\n")
    with atomic_path(picture) as temporary:
        save_flat(draw(plant, exhibit, cases), temporary)
    return [page, picture]


def _text(plant: Plant, exhibit: Exhibit, cases: dict[str, Shown]) -> str:
    model = plant.model()
    uncertain = ", ".join(f"`{name}`" for name in exhibit.uncertain)
    begin = f"{100.0 * STEADY_FROM:g} %"
    kind = "a step of D₀/2" if exhibit.steps else f"a sine of D₀/2 and {_period(plant.pace)}"
    return f"""\
# {exhibit.title}

<!-- Written by `python -m benchmarks.gallery`; changes belong there. -->

![True disturbance, estimate and error bar]({plant.name}.png)

{exhibit.text}
## Equations

`examples/{plant.name}.py`, built by `ndob-fmu build examples/{plant.name}.py`:

```{{literalinclude}} ../../examples/{plant.name}.py
:language: python
:pyobject: dynamics
```

## Figures

One record of {plant.stop_time:g} s in steps of {_step(model.experiment.step_size)}, judged from {begin} of it on. Each
disturbance is {kind}. In the records with parameters off, each of {uncertain} is 15 % larger or
smaller in the true plant, at random. "Told" means that the observer has `<parameter>_std` = 15 %. The EKF has the same
noise, bound and pace, and is tuned by a scan on other records; it has no `<parameter>_std`.

{table(plant, cases)}
"""


def _step(H: float) -> str:
    return ms(H) if H < 1.0 else f"{H:g} s"


def _period(pace: float) -> str:
    return f"{pace:g} Hz" if pace >= 0.1 else f"a period of {1.0 / pace:g} s"


def write_index(folder: Path, shown: Sequence[tuple[Plant, Exhibit]]) -> Path:
    """Write the page that leads to the others."""
    rows = "\n".join(
        f"| [{exhibit.title}]({plant.name}.md) | {_listed(model.disturbances)} | {_listed(model.outputs)} |"
        for plant, exhibit in shown
        for model in [plant.model()]
    )
    names = "\n".join(plant.name for plant, _ in shown)
    path = folder / "index.md"
    with atomic_path(path) as temporary:
        temporary.write_text(_INDEX.format(rows=rows, names=names, emps=EMPS), "utf-8", newline="\n")
    return path


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


_INDEX = """\
# Gallery

<!-- Written by `python -m benchmarks.gallery`; changes belong there. -->

Plants that engineers have, written as in a textbook ([writing a model](../models.md)). Each page shows the estimate
with its error bar beside the true disturbance, with the exact model and with parameters that are 15 % off, and says
what to set and why. The files are in `examples/`; copy the nearest one.

| plant | unknown | measured |
|---|---|---|
{rows}

A page on a measured record of a real drive goes from the record to `fit` and to the estimate:

| plant | unknown | measured |
|---|---|---|
| [{emps}](emps.md) | `force` | `position` |

```{{toctree}}
:hidden:

{names}
emps
```
"""
