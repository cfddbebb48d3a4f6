"""The page: which estimator is more accurate and why, computed from the scores, then all figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from benchmarks.accuracy_cells import AFTER_STEP, D0, PAPER_RAMP, STEADY_FROM, Plan, Score, Scores, Signal, fitting_pi
from benchmarks.accuracy_must_show import Row, as_text
from benchmarks.estimator import page as estimator_page
from benchmarks.estimator.page import Results, save_flat
from ndob_fmu.support.files import atomic_path

SAME = 0.01  # two errors that differ by less count as equal
ROUNDING = 5e-8  # errors below it are rounding errors of the samples, on a disturbance of size one
COLUMNS = {
    "ours r=2": "ours, r = 2",
    "ours r=3": "ours, r = 3",
    "EKF r=2": "EKF, r = 2",
    "EKF r=3": "EKF, r = 3",
    "EKF r=2, scan": "EKF, r = 2, best",
    "EKF r=3, scan": "EKF, r = 3, best",
    "paper, held": "paper, y held",
    "paper, polynomial": "paper, y polynomial",
    "paper π*, held": "paper at π*, y held",
    "paper π*, polynomial": "paper at π*, y polynomial",
    "ESO r=1, scan": "ESO, r = 1, best",
    "ESO r=3, scan": "ESO, r = 3, best",
    "inverse": "second difference",
}
REASONS = {
    "rounding": "both errors are below 5e-8: rounding errors of samples and arithmetic, which a slower filter averages",
    "signal": "a scan has tuned this EKF to this signal, ours is tuned by the bound only; with the same information "
    "the EKF is not better than ours",
    "scatter": "the difference is within the scatter of the records (two standard errors of their mean ratio)",
    "unexplained": "ours is worse, for a reason that this script does not know",
}


def write(folder: Path, plan: Plan, scores: Scores, required: Sequence[Row], plants: Results) -> list[Path]:
    """Write `accuracy.md` and its figures into the folder and return their paths."""
    page, figure = folder / "accuracy.md", folder / "accuracy.png"
    with atomic_path(page) as temporary:
        temporary.write_text(text(plan, scores, required, plants), "utf-8", newline="\n")
    with atomic_path(figure) as temporary:
        save_flat(plot(plan, scores), temporary)
    return [page, figure, *estimator_page.plot(folder, plants)]


def text(plan: Plan, scores: Scores, required: Sequence[Row], plants: Results) -> str:
    """Return the page."""
    ratios, losses = ratio_table(plan, scores)
    noise_tables = "\n\n".join(
        f"### {_noise(sigma)}\n\n{error_table(plan, scores, sigma, 'error', COLUMNS)}" for sigma in plan.noises
    )
    ahead = {name: title for name, title in COLUMNS.items() if not name.startswith(("paper", "inverse"))}
    ahead_tables = "\n\n".join(
        f"### {_noise(sigma)}\n\n{error_table(plan, scores, sigma, 'ahead', ahead)}" for sigma in plan.noises
    )
    parts = [_INTRODUCTION, "## Ours against the extended Kalman filter", _RATIO_TEXT, ratios, losses]
    parts += ["## Required and measured", _REQUIRED_TEXT, as_text(required)]
    parts += [
        "## Error at the sample",
        _error_text(plan),
        noise_tables,
        *filter(None, [beyond_the_signal(plan, scores)]),
    ]
    parts += ["![Error over the step size](accuracy.png)"]
    parts += ["## Error of the prediction for the end of the step", _AHEAD_TEXT, ahead_tables]
    parts += ["## Start-up and step", _START_TEXT, start_table(plan, scores)]
    parts += ["## How it was measured", _method_text(plan)]
    parts += estimator_page.sections(plants)
    return "\n\n".join(parts) + "\n"


# -- ours over EKF, and the reasons


def ratio_table(plan: Plan, scores: Scores) -> tuple[str, str]:
    """Return the table of ratios with reasons, and the count of what it shows."""
    letters: dict[str, str] = {}
    counts: Counter[tuple[str, str]] = Counter()
    columns = [(H, order) for H in plan.steps for order in plan.orders]
    lines = [
        "| disturbance | noise | " + " | ".join(f"{_ms(H)}, r = {order}" for H, order in columns) + " |",
        "|---|---|" + "---|" * len(columns),
    ]
    for signal in plan.signals:
        for sigma in plan.noises:
            cells = []
            for H, order in columns:
                both = []
                for baseline in ("", ", scan"):
                    ratio, reason = compare(plan, scores, H, signal, sigma, order, baseline)
                    counts[baseline, _outcome(ratio, reason)] += 1
                    shown = f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:.0f}"
                    if ratio > 1.0 + SAME:
                        shown = f"**{shown}**"
                    if reason:
                        shown += f" ({letters.setdefault(reason, 'abcde'[len(letters)])})"
                    both.append(shown)
                cells.append(" / ".join(both))
            lines.append(f"| {signal.name} | {_noise(sigma)} | " + " | ".join(cells) + " |")
    reasons = [f"- ({letter}) {REASONS[reason]}" for reason, letter in letters.items()]
    summary = [
        _summary("With the same information", counts, "", letters),
        _summary("Against the EKF at the best intensity that a scan finds in each cell", counts, ", scan", letters),
    ]
    return "\n".join(lines), "\n\n".join(["\n".join(reasons), *summary])


def compare(
    plan: Plan, scores: Scores, H: float, signal: Signal, sigma: float, order: int, baseline: str
) -> tuple[float, str]:
    """Return the error of ours over the EKF's and a key of REASONS, always where it is larger, or ""."""

    def of(estimator: str) -> Score:
        return scores[H, signal.name, sigma, estimator]

    ours, told, other = of(f"ours r={order}"), of(f"EKF r={order}"), of(f"EKF r={order}{baseline}")
    ratio = ours.error / other.error
    if max(ours.error, other.error) <= ROUNDING:
        return ratio, "rounding"
    if ratio <= 1.0 + SAME:
        return ratio, ""
    if baseline and ours.error <= told.error * (1.0 + SAME):
        return ratio, "signal"
    each = np.array(ours.each) / np.array(other.each)
    if len(each) > 1 and np.mean(each) - 1.0 <= 2.0 * np.std(each, ddof=1) / np.sqrt(len(each)):
        return ratio, "scatter"
    return ratio, "unexplained"


def _outcome(ratio: float, reason: str) -> str:
    if reason == "rounding":
        return reason
    if ratio > 1.0 + SAME:
        return reason
    return "smaller" if ratio < 1.0 - SAME else "equal"


def _summary(title: str, counts: Counter[tuple[str, str]], baseline: str, letters: dict[str, str]) -> str:
    outcomes = {outcome: number for (kind, outcome), number in counts.items() if kind == baseline}
    total = sum(outcomes.values())
    smaller, equal, rounding = (outcomes.pop(name, 0) for name in ("smaller", "equal", "rounding"))
    why = ", ".join(f"{number} for ({letters[reason]})" for reason, number in outcomes.items())
    return (
        f"{title}: of {total} cells {rounding} show rounding errors only. In the others the error of ours is smaller "
        f"in {smaller}, equal within {SAME:.0%} in {equal} and larger in {sum(outcomes.values())}"
        + (f", {why}." if why else ".")
    )


def beyond_the_signal(plan: Plan, scores: Scores) -> str:
    """Return the cells in which ours is not better than d̂ = 0; "" if there are none."""
    cells = []
    for signal in plan.signals:
        for sigma in plan.noises:
            for H in plan.steps:
                orders = [
                    str(r)
                    for r in plan.orders
                    if scores[H, signal.name, sigma, f"ours r={r}"].error >= _of_zero(signal)
                ]
                if orders:
                    cells.append(f"{signal.name}, {_noise(sigma)}, {_ms(H)} (r = {' and '.join(orders)})")
    if not cells:
        return ""
    return (
        f"Not better than d̂ = 0: {'; '.join(cells)}. There the samples contain too little information about so fast a "
        "disturbance, and an estimator that knows only |d| ≤ D₀ cannot choose d̂ = 0."
    )


def _of_zero(signal: Signal) -> float:
    """Return the error of d̂ = 0 in a noisy cell, by the measure of that cell; of a ramp at most that of its end."""
    return signal.amplitude / np.sqrt(2.0) if signal.kind == "chirp" else signal.amplitude


# -- tables


def error_table(plan: Plan, scores: Scores, sigma: float, which: str, columns: dict[str, str]) -> str:
    """Return the errors of one noise, a row per disturbance and step size, the smallest of each row bold."""
    shown = {
        name: title for name, title in columns.items() if (plan.steps[0], plan.signals[0].name, sigma, name) in scores
    }
    lines = ["| disturbance | H | " + " | ".join(shown.values()) + " |", "|---|---|" + "---|" * len(shown)]
    for signal in plan.signals:
        for H in plan.steps:
            values = [getattr(scores[H, signal.name, sigma, name], which) for name in shown]
            lines.append(f"| {signal.name} | {_ms(H)} | " + " | ".join(_bold_least(values, _number)) + " |")
    return "\n".join(lines)


def start_table(plan: Plan, scores: Scores) -> str:
    """Return samples to 2 % and peak at the start, and the steps to 2 % after a step, without noise."""
    names = {s.kind: s.name for s in plan.signals}
    lines = [
        "| estimator | " + " | ".join(f"{_ms(H)}: samples, peak, steps" for H in plan.steps) + " |",
        "|---|" + "---|" * len(plan.steps),
    ]
    for estimator, title in COLUMNS.items():
        cells = []
        for H in plan.steps:
            start = scores.get((H, names["constant"], 0.0, estimator))
            step = scores.get((H, names.get("step", ""), 0.0, estimator))
            if start is None:
                break
            cells.append(
                ", ".join(
                    [
                        "never" if start.samples_to_2_percent is None else str(start.samples_to_2_percent),
                        _number(start.peak),
                        "–"
                        if step is None
                        else "never"
                        if step.steps_after_step is None
                        else str(step.steps_after_step),
                    ]
                )
            )
        if cells:
            lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _bold_least(values: Sequence[float], form: Callable[[float], str]) -> list[str]:
    least = form(min(values))
    return [f"**{form(value)}**" if form(value) == least else form(value) for value in values]


def _number(value: float) -> str:
    if value >= 100.0:
        return f"{value:.0f}" if value < 1e5 else f"{value:.1e}".replace("e+0", "e")
    return f"{value:.2g}".replace("e-0", "e-")


def _ms(H: float) -> str:
    return f"{H * 1e3:g} ms"


def _noise(sigma: float) -> str:
    return f"σ = {sigma:.0e}".replace("e-0", "e-") if sigma > 0.0 else "no noise"


# -- words

_INTRODUCTION = f"""# How accurate is the estimate, and compared with what?

<!-- Written by `python -m benchmarks.accuracy`; changes belong there. -->

This page compares estimators over step size H, disturbance and measurement noise σ. Ours is the observer FMU
(method 2). The first part is about the paper's flexible joint with both angles measured, disturbed by a torque on its
motor with |d| ≤ D₀ = {D0:g}. The second part, [on four plants](#on-four-plants-good-samples), has faulty samples,
statements that are half true, steps that vary and estimates with a lag."""

_RATIO_TEXT = """\
The table has the error of ours divided by the error of the EKF with as many integrated disturbances, at the sample.
The first number is for the EKF with the same information (σ, D₀, D_r, prior), tuned by the same principle. The second
is for the EKF with the best tuning for this cell. Below 1 ours is more accurate. Where ours is less accurate, the
number is bold and a letter gives the reason."""

_REQUIRED_TEXT = """\
These values are not from the cells below; records with noise are longer. The best over all intensities is computed
from the linear error dynamics."""

_AHEAD_TEXT = "d̂(t_k + H | y_k) is compared with d(t_k + H) as above. Scans use the tuning that is best at the sample."

_START_TEXT = """\
These runs have no noise. The first columns are for a start from x̂(0) = −x(0) with d = 2: the number of samples after
which d̂ stays within 2 %, and the largest |d̂|. The last is for the step of 2 at 1 s: the number of steps until d̂ stays
within 2 %."""


def _error_text(plan: Plan) -> str:
    records = "" if plan.records == 1 else f" of {plan.records} records"
    return f"""d̂(t_k | y_k) is compared with d(t_k) from {STEADY_FROM:g} s to {plan.stop_time:g} s, for the step from
{AFTER_STEP:g} s after it. Without noise the number is the largest error. With noise{records} it is |bias| + standard
deviation; the bias is the mean and, for a sine, also the amplitude of the error at the sine's frequency. For the chirp
it is the root mean square. The smallest of a row is bold."""


def _method_text(plan: Plan) -> str:
    fitting = ",\n  ".join(
        f"{fitting_pi(sigma, signal):.1e} ({_noise(sigma)}, {signal.pace:g} Hz)"
        for sigma in plan.noises
        if sigma > 0.0
        for signal in {s.pace: s for s in plan.signals}.values()
    )
    return f"""- **Plant**: `FlexibleJointPlant.fmu` from x(0) = (1, 1, 1, 1), u = 0. The chirp's frequency rises by
  1.2 Hz per second. The noise is white and normal, of seed {plan.seed}, and the same for all estimators.
- **Ours**: `FlexibleJointObserver.fmu`, without noise in co-simulation with the plant, with noise from the recorded
  samples. It knows σ, D₀ and D_r, the bound of the r-th derivative of all sines of amplitude 1 up to 1 Hz, (2π)^r,
  for constant, ramp, step and sine 1 Hz, and up to 5 Hz, (10π)^r, for sine 5 Hz and chirp.
- **EKF**: extended Kalman filter with r integrated disturbances, linearised at every step, discretised by Van Loan's
  formula, covariances as square roots, predicted by Runge–Kutta; the same prior as ours. Its intensity
  minimises the worst bias for D_r plus the noise, as ours does, for the joint linearised where it hangs down. *Best*
  has the least error in each cell over {plan.scan} intensities and {plan.refinement} more around the best of them.
- **Paper**: eqs. (22)–(24), α = 1, π from 1 to 1e12 in {PAPER_RAMP:g} s instead of 10 s, because the runs are short;
  that only raises its peak at the start. y between samples: held, or the polynomial through the latest three. It has no
  parameter for σ, so with noise it is also run at the π that balances bias and noise, π* = (D₁/(√2 σ))^(4/3):
  {fitting or "none here"}. Of its two estimates, at the sample and for the step's end, the better one is shown.
- **ESO**: linear extended state observer of the motor equation with r integrated disturbances (r = 1 is the classical
  one), the link's angle taken from its samples, all poles at one bandwidth, which a scan optimises in each cell.
- **Second difference**: the motor equation solved for d with central differences of the three latest samples. It is
  the disturbance of one sample ago."""


# -- figure

_LINES: dict[str, dict[str, Any]] = {
    "ours r=2": {"color": "C0", "marker": "o"},
    "ours r=3": {"color": "C3", "marker": "o"},
    "EKF r=2": {"color": "C0", "linestyle": "--", "marker": "x", "markersize": 7},
    "EKF r=3": {"color": "C3", "linestyle": "--", "marker": "x", "markersize": 7},
    "EKF r=3, scan": {"color": "C1", "linestyle": ":", "marker": "+"},
    "paper, held": {"color": "0.65", "marker": "v"},
    "paper, polynomial": {"color": "0.4", "marker": "^"},
    "paper π*, polynomial": {"color": "0.4", "linestyle": ":", "marker": "^"},
    "ESO r=1, scan": {"color": "C2", "marker": "s"},
    "inverse": {"color": "C4", "marker": "d"},
}


def plot(plan: Plan, scores: Scores) -> Figure:
    """Draw the error at the sample of the 1 Hz sine over H, a panel for each noise."""
    style: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "lines.markersize": 5, "lines.linewidth": 1.2}
    sine = next(signal for signal in plan.signals if signal.kind == "sine")
    with mpl.rc_context(style):
        figure = Figure(figsize=(9.0, 4.5), layout="constrained")
        panels = figure.subplots(1, len(plan.noises), sharex=True, sharey=True, squeeze=False)[0]
        handles: dict[str, Any] = {}
        for axes, sigma in zip(panels, plan.noises, strict=True):
            for name, look in _LINES.items():
                if (plan.steps[0], sine.name, sigma, name) not in scores:
                    continue
                errors = [scores[H, sine.name, sigma, name].error for H in plan.steps]
                (handles[COLUMNS[name]],) = axes.loglog([H * 1e3 for H in plan.steps], errors, **look)
            axes.set_title(f"{sine.name}, {_noise(sigma)}")
            axes.set_xticks([H * 1e3 for H in plan.steps], [f"{H * 1e3:g}" for H in plan.steps])
            axes.minorticks_off()
            axes.set_xlabel("H [ms]")
        panels[0].set_ylabel("error of d̂")
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, frameon=False)
    return figure
