"""The part of the page on several plants: its tables and figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure as Drawing
from PIL import Image

from benchmarks.estimator import figures, must_show
from benchmarks.estimator.comparison import FAULTY, GOOD, LATER, SHOWN, WRONG, Cell, Scores, cells, compared
from benchmarks.estimator.fault_rows import H, faulty_record
from benchmarks.estimator.figures import Figure
from benchmarks.estimator.kalman import ekf
from benchmarks.estimator.must_show import Parallel
from benchmarks.estimator.ours import ours_of, published_intensity
from benchmarks.estimator.plants import JOINT, PLANTS
from benchmarks.estimator.scores import Score
from benchmarks.estimator.tasks import Seeds, ms
from ndob_fmu.support.files import atomic_path

PLANTS_PNG, FAULTS_PNG = "accuracy_plants.png", "accuracy_faults.png"
ESTIMATORS = {
    "ours": "ours",
    "EKF": "EKF, its best",
    "EKF, same": "EKF, same intensity",
    "UKF": "UKF",
    "ESO": "linear ESO, best",
    "differentiator": "differentiator, best",
}


@dataclass(frozen=True)
class Results:
    """The scores of the cells, the required figures, and the seeds of the records."""

    cells: list[Cell]
    scores: list[Scores]
    required: list[Figure]
    seeds: Seeds

    def of(self, group: str) -> list[tuple[Cell, Scores]]:
        """Return cells and scores of a group."""
        return [(cell, found) for cell, found in zip(self.cells, self.scores, strict=True) if cell.group == group]


def run_all(
    seeds: Sequence[int], in_parallel: Parallel, workers: int, *, few: int | None = None, plants: str = ""
) -> Results:
    """Run all cells and required figures; `few` and `plants` as in `_chosen` for a smoke test."""
    seeds = tuple(seeds)
    chosen = _chosen(few, plants)
    jobs = [(_run_cell, index, seeds, few, plants) for index in range(len(chosen))]
    scores = in_parallel("plants", jobs, workers)
    pattern = "" if few is None else f"fault {plants} 12 stuck"
    return Results(chosen, scores, must_show.measured(pattern, seeds, in_parallel, workers), seeds)


def _chosen(few: int | None, plants: str) -> list[Cell]:
    """Return the cells, or a few of each kind and of the plant of that name."""
    return cells(few, [plant for plant in PLANTS if plants in ("", plant.name)])


def _run_cell(index: int, seeds: Seeds, few: int | None, plants: str) -> Scores:
    # A worker gets the number, because a cell has functions that cannot be pickled.
    return compared(_chosen(few, plants)[index], seeds)


# -- text


def sections(results: Results) -> list[str]:
    """Return the sections of the page."""
    count = len(results.seeds)
    return [
        "## On four plants: good samples",
        _GOOD_TEXT.format(count=count, plants=_plant_lines()),
        _table(results.of(GOOD), "H", {**_errors(), **_BARS}),
        f"![Error on four plants]({PLANTS_PNG})",
        "## Faulty samples",
        _FAULTY_TEXT,
        _table(results.of(FAULTY), "5 ms", {**_both(), **_PEAKS, **_BARS, **_CHANGES}),
        f"![The joint with faults]({FAULTS_PNG})",
        "## Half-true statements and steps that vary",
        _WRONG_TEXT,
        _table(results.of(WRONG), "5 ms", {**_both(), **_BARS, **_CHANGES}),
        "## A little later",
        _LATER_TEXT,
        _table(results.of(LATER), "lag", {**_both("EKF, smoothed"), "ours within 2·std": _of("ours", _covered)}),
        "## Plants of the gallery",
        _SHOWN_TEXT,
        _table(results.of(SHOWN), "H", {**_both(ESTIMATORS["EKF"]), **_SAME, **_BARS}),
        "## Required on these plants",
        _REQUIRED_TEXT,
        figures.as_text([figure for figure in results.required if not figure.timed]),
    ]


Column = Callable[[Scores], str]


def _table(rows: Sequence[tuple[Cell, Scores]], what: str, columns: dict[str, Column]) -> str:
    lines = [f"| plant | {what} | " + " | ".join(columns) + " |", "|---|---|" + "---|" * len(columns)]
    for cell, scores in rows:
        shown = [column(scores) for column in columns.values()]
        lines.append(f"| {cell.plant.name} | {cell.text} | " + " | ".join(shown) + " |")
    return "\n".join(lines)


def _of(estimator: str, value: Callable[[Score], str]) -> Column:
    def column(scores: Scores) -> str:
        found = scores.get(estimator)
        return value(found) if isinstance(found, Score) else "–"

    return column


def _error_of_ours(scores: Scores) -> str:
    """Return the error, or why there is none."""
    found = scores["ours"]
    return _number(found.rms) if isinstance(found, Score) else found


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "diverged"
    return f"{value:.4f}" if value < 0.1 else f"{value:.3g}"


def _covered(found: Score) -> str:
    return "–" if np.isnan(found.covered) else f"{found.covered:.1%}"


def _errors() -> dict[str, Column]:
    others = [name for name in ESTIMATORS if name != "ours"]
    return {"ours": _error_of_ours, **{ESTIMATORS[name]: _of(name, lambda s: _number(s.rms)) for name in others}}


def _both(title: str = "EKF") -> dict[str, Column]:
    return {"ours": _error_of_ours, title: _of("EKF", lambda s: _number(s.rms))}


_PEAKS: dict[str, Column] = {
    "peak of ours": _of("ours", lambda s: _number(s.peak)),
    "peak of EKF": _of("EKF", lambda s: _number(s.peak)),
}
_BARS: dict[str, Column] = {
    "ours within 2·std": _of("ours", _covered),
    "EKF within 2·std": _of("EKF", _covered),
    "`valid`": _of("ours", lambda s: f"{s.valid:.1%}"),
}
_SAME: dict[str, Column] = {ESTIMATORS["EKF, same"]: _of("EKF, same", lambda s: _number(s.rms))}
_CHANGES: dict[str, Column] = {"changes of `valid`": _of("ours", lambda s: f"{s.toggles:.1f}")}


def _plant_lines() -> str:
    return "\n".join(
        f"- **{plant.name}**: {plant.model().description}; D₀ = {plant.bound:g}, σ = "
        + ", ".join(f"{s:g} ({y})" for s, y in zip(plant.sigma, plant.model().outputs, strict=True))
        for plant in PLANTS
    )


_GOOD_TEXT = """\
Root mean square of d̂(t_k | y_k) − d(t_k) in units of D₀ over {count} records, from 30 % of a record on. d is a sine of
1 Hz and amplitude D₀/2, declared as |d| ≤ D₀ and |d''| ≤ D₀ (2π)²; r = 2. The truth is integrated by
`benchmarks/estimator/records.py`.

{plants}

- **ours** is the observer FMU's code, run in the process of the benchmark, with σ, D₀ and the rate as parameters.
- **EKF, its best** has the intensity with the least error for a sine of 1 Hz and amplitude D₀, the largest of the
  declared class, on records of its own. **EKF, same intensity** has the one of ours.
- **UKF**: 2 N sigma points, the intensity of ours; for the arm, of which ours estimates the torques, the EKF's best.
- **linear ESO** and **differentiator** (Levant's, of second order) work on the equation of motion that d acts in. The
  bandwidth and the bound of the third derivative are the best of a scan in each cell, on the very record.
- **within 2·std**: share of the predictions d̂(t_k + H | y_k) whose error is below two error bars. 95 % is what a
  normal error gives; for a sine the bias is always inside, so that the share is higher."""

_FAULTY_TEXT = """\
The samples are those of the same sine, with outliers, repeated or stuck ones as `benchmarks/estimator/faults.py` makes
them. In the rows of a jump d goes from −D₀ to D₀ in the middle of the record. The EKF (its best intensity) takes every
sample as good. The peak is the largest error in D₀."""

_WRONG_TEXT = """\
The observers are told something that is not quite true. The EKF is told the same σ and tuned for that. In the rows of
parameters ± 10 % each parameter of the true plant is drawn with that standard deviation, and σ is 1e-6 for all
outputs."""

_LATER_TEXT = """\
The estimate for `lag` before the sample, with H = 5 ms. The EKF is smoothed over the same lag, with the intensity of
ours."""

_SHOWN_TEXT = """\
The [gallery](gallery/index.md) has the plants. Several disturbances are sines with a radian between them, and the error
is the RMS of all in units of their bounds. Encoders round, other sensors have noise. The EKF has the same noise, bound
and pace."""

_REQUIRED_TEXT = """\
The number is the RMS error in D₀ where the row names nothing else. A limit that is a multiple of another filter's error
is measured on the same records. Times are shown by `python -m benchmarks.accuracy --must-show` only."""


# -- figures


def plot(folder: Path, results: Results) -> list[Path]:
    """Write the figures into the folder and return their paths."""
    drawn = {PLANTS_PNG: _on_plants(results), FAULTS_PNG: _with_faults(results.seeds[:1])}
    for name, drawing in drawn.items():
        with atomic_path(folder / name) as temporary:
            save_flat(drawing, temporary)
    return [folder / name for name in drawn]


def save_flat(drawing: Drawing, path: Path) -> None:
    """Write a figure of few colours as a PNG with a palette, which makes the file a quarter as large."""
    pixels = BytesIO()
    drawing.savefig(pixels, dpi=90, format="png")
    with Image.open(pixels) as image:
        image.convert("RGB").quantize(48, dither=Image.Dither.NONE).save(path, format="PNG", optimize=True)


_MARKS: dict[str, dict[str, Any]] = {
    "ours": {"color": "C3", "marker": "o", "markersize": 8},
    "EKF": {"color": "C0", "marker": "x", "markersize": 8},
    "EKF, same": {"color": "C0", "marker": "+", "markersize": 9},
    "ESO": {"color": "C2", "marker": "s", "markersize": 5},
    "differentiator": {"color": "C4", "marker": "d", "markersize": 6},
}
_STYLE: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}


def _on_plants(results: Results) -> Drawing:
    """Draw the errors of all estimators, a column for each plant and step."""
    rows = results.of(GOOD)
    with mpl.rc_context(_STYLE):
        drawing = Drawing(figsize=(9.0, 4.5), layout="constrained")
        axes = drawing.subplots()
        for name, look in _MARKS.items():
            found = [scores.get(name) for _, scores in rows]
            errors = [score.rms if isinstance(score, Score) else np.nan for score in found]
            axes.semilogy(range(len(rows)), errors, linestyle="none", label=ESTIMATORS[name], **look)
        axes.set_xticks(range(len(rows)), [f"{cell.plant.name}\n{cell.text}" for cell, _ in rows])
        axes.set_ylabel("RMS error of d̂ / D₀")
        drawing.legend(loc="outside upper center", ncols=len(_MARKS), frameon=False)
    return drawing


def _with_faults(seeds: Seeds) -> Drawing:
    """Draw d and its estimates on the joint: samples stuck, and a jump among outliers."""
    intensity = published_intensity(JOINT, H)
    with mpl.rc_context(_STYLE):
        drawing = Drawing(figsize=(9.0, 6.0), layout="constrained")
        for axes, fault in zip(drawing.subplots(2, 1), ("12 stuck", "jump and outliers"), strict=True):
            record = faulty_record(JOINT, fault, seeds)
            found, other = ours_of(record), ekf(record, intensity=intensity)
            shown = (record.t > 1.2) & (record.t < 2.4)
            t, d_hat, std = record.t[shown], found["ahead"][0, shown, 0], found["std"][0, shown, 0]
            axes.plot(t, record.d[shown, 0], color="black", label="d")
            axes.plot(t, other["at"][0, shown, 0], color="C0", linewidth=0.9, label="EKF that takes every sample")
            axes.plot(t, found["at"][0, shown, 0], color="C3", label="ours")
            axes.fill_between(
                t + H, d_hat - 2.0 * std, d_hat + 2.0 * std, color="C3", alpha=0.2, label="ours ± 2·std, a step ahead"
            )
            axes.set_title(f"{JOINT.name}, {ms(H)}, {fault}")
            axes.set_ylim(-3.0 * JOINT.bound, 3.0 * JOINT.bound)
            axes.set_ylabel("d [N·m]")
        axes.set_xlabel("t [s]")
        axes.legend(loc="lower right", ncols=2)
    return drawing
