"""The figures that the observer is required to reach, required beside measured, measured through the FMUs."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from benchmarks.accuracy_cells import D0, MODEL, SIGNALS, Plan, Record, in_parallel, observed, record, score, setting
from ndob_fmu import build, load_model
from ndob_fmu.runtime.design.augmented import augment
from ndob_fmu.runtime.design.stationary_design import StationaryDesign, stationary_design
from ndob_fmu.runtime.design.tuning import at_bandwidth

CONSTANT, RAMP, _, SINE_1, SINE_5, _ = SIGNALS
_REQUIRED_SINE = {SINE_1: {1e-3: 2e-7, 5e-3: 2e-5, 1e-2: 2e-4}, SINE_5: {1e-3: 2e-5, 5e-3: 2e-3, 1e-2: 1.5e-2}}
_REQUIRED_SAMPLES = {1e-3: 10.0, 5e-3: 10.0, 1e-2: 12.0}
_STEADY_FROM, _STOP_TIME = 1.0, 3.0


@dataclass(frozen=True)
class Row:
    """One requirement: measured ≤ required at the step H (s); a required of None asks for a report only."""

    text: str
    H: float
    required: float | None
    measured: float

    @property
    def verdict(self) -> str:
        """Return ok, short or reported."""
        if self.required is None:
            return "reported"
        return "ok" if self.measured <= self.required else "**short**"


def measure(plan: Plan, workers: int) -> list[Row]:
    """Return all rows for the plan's step sizes; its seed is that of the noise."""
    with tempfile.TemporaryDirectory(prefix="ndob_accuracy_") as folder:
        fmus = build(load_model(MODEL), folder)
        noiseless = [(_noiseless, fmus, H, replace(plan, stop_time=_STOP_TIME)) for H in plan.steps]
        noisy = [
            (_noisy, fmus, H, sigma, order, replace(plan, stop_time=plan.long_stop_time))
            for H in plan.steps
            for sigma in sorted(plan.noises, reverse=True)
            if sigma > 0.0
            for order in plan.orders
        ]
        rows = [row for rows in in_parallel("required figures", [*noiseless, *noisy], workers) for row in rows]
    texts = list(dict.fromkeys(row.text for row in rows))
    return sorted(rows, key=lambda row: (texts.index(row.text), row.H))


def _noiseless(fmus: tuple[Path, Path], H: float, plan: Plan) -> list[Row]:
    constant = record(fmus, H, CONSTANT, plan, orders=(1, 2, 3))
    ramp = record(fmus, H, RAMP, plan, orders=(2, 3))
    sines = {signal: record(fmus, H, signal, plan, orders=(3,)) for signal in (SINE_1, SINE_5)}
    steady = round(_STEADY_FROM / H)

    def errors(data: Record, order: int) -> tuple[float, float]:
        at_sample, ahead = data.ours[order]
        return (
            float(np.max(np.abs(at_sample - data.d[:-1])[steady:])),
            float(np.max(np.abs(ahead - data.d[1:])[steady:])),
        )

    rows = [
        Row("constant 2, r = 1, 2, 3: largest error", H, 1e-7, max(max(errors(constant, r)) for r in (1, 2, 3))),
        Row("ramp 1/s, r = 2, 3: largest error", H, 1e-7, max(max(errors(ramp, r)) for r in (2, 3))),
    ]
    for signal, data in sines.items():
        at_sample, ahead = errors(data, 3)
        bound = 3.3 * H**3 * signal.rate(3)
        rows.append(
            Row(f"{signal.name}, r = 3: largest error at the sample", H, _REQUIRED_SINE[signal].get(H), at_sample)
        )
        rows.append(Row(f"{signal.name}, r = 3: largest error of the prediction, 3.3·H³·max abs d'''", H, bound, ahead))
    starts = [score(constant, 0.0, *(e[None] for e in constant.ours[r])) for r in (1, 2, 3)]
    samples = max(float("inf") if s.samples_to_2_percent is None else s.samples_to_2_percent for s in starts)
    rows.append(Row("start-up from −x(0), r = 1, 2, 3: samples to 2 %", H, _REQUIRED_SAMPLES.get(H), samples))
    rows.append(Row("start-up from −x(0): largest abs d̂, 3·D₀", H, 3.0 * D0, max(s.peak for s in starts)))
    return rows


def _noisy(fmus: tuple[Path, Path], H: float, sigma: float, order: int, plan: Plan) -> list[Row]:
    plant = record(fmus, H, SINE_1, plan, orders=(order,))
    runs = np.array([observed(fmus, plant, samples, sigma, order) for samples in plant.noisy(sigma, plan)])
    measured = score(plant, sigma, runs[:, 0], runs[:, 1]).error
    text = (
        f"σ = {sigma:.0e}, sine 1 Hz, r = {order}: bias amplitude + std, 1.15 × the best over all intensities".replace(
            "e-0", "e-"
        )
    )
    return [Row(text, H, 1.15 * least_error(H, sigma, order) if H == 1e-3 else None, measured)]


def least_error(H: float, sigma: float, order: int) -> float:
    """Return the least bias amplitude + std for a sine of 1 Hz and amplitude 1 that any intensity gives.

    From the linear error dynamics, ξ̃⁺ = F ξ̃ + (I − K C) w with w the disturbance's share over a step.
    """
    known, system = setting().known(order, sigma, SINE_1), augment(setting().linear, order)

    def error(bandwidth: float) -> float:
        intensities = at_bandwidth(system, H, bandwidth, known)
        design = stationary_design(system, H, known.R_factor, intensities, 1.0)
        return bias_amplitude(design, SINE_1.frequency) + float(design.noise_std()[0])

    # The least over a grid of which neighbours differ by 6 % in bandwidth is within 0.5 % of the least of all.
    return min(error(bandwidth) for bandwidth in np.geomspace(5.0, 200.0, 60))


def bias_amplitude(design: StationaryDesign, frequency: float) -> float:
    """Return the amplitude of d̂ − d at the samples for d a sine of that frequency (Hz) and amplitude 1, for q2 = 1."""
    system, H = design.system, design.discrete.H
    N, omega = len(system.A), 2.0 * np.pi * frequency
    joined = np.zeros((N + 1, N + 1), dtype=complex)
    joined[:N, :N], joined[:N, N:], joined[N, N] = system.A, system.noise, 1j * omega
    share = expm(joined * H)[:N, N] * omega**system.order
    identity = np.eye(N)
    error = np.linalg.solve(
        np.exp(1j * omega * H) * identity - design.error_dynamics, (identity - design.K @ system.C) @ share
    )
    assert system.selector is not None
    return float(np.abs(system.selector @ error)[0])


def as_text(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table, one line per requirement and step size."""
    lines = ["| measured through the FMUs | H | required ≤ | measured | |", "|---|---|---|---|---|"]
    for row in rows:
        required = "–" if row.required is None else f"{row.required:.3g}"
        lines.append(f"| {row.text} | {row.H * 1e3:g} ms | {required} | {row.measured:.3g} | {row.verdict} |")
    return "\n".join(lines)
