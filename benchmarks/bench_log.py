"""(j) `ndob-fmu estimate` over a log of 25 000 rows: the steps in Python and by the native observer."""

from __future__ import annotations

from math import sin
from time import process_time

import numpy as np

from benchmarks.figures import Section, Time, compared
from benchmarks.models import carts
from ndob_fmu import load_model
from ndob_fmu.log import estimate_log as estimate_module
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.made_log import Sensor, make_log, steps
from ndob_fmu.native.build import build_native

ROWS, STEP = 25_000, 2e-3
NOISE = 1e-4
NATIVE, PYTHON = "native observer", "observer in Python"


def test_log(benchmark, section, tmp_path, monkeypatch):
    joint = load_model("flexible_joint")
    # The largest one is not run in Python: what takes the time there is the covariance, as with n = 4.
    cases = {2: (carts(1), (NATIVE, PYTHON)), 4: (joint, (NATIVE, PYTHON)), 6: (carts(3), (NATIVE,))}
    for n, (model, _) in cases.items():
        _make(model, tmp_path / f"log{n}.csv")
        build_native(model, tmp_path / "fmus")
    figures = [0.0]
    monkeypatch.setattr(estimate_module, "write_figures", _timed(estimate_module.write_figures, figures))
    times, drawn = {}, {}

    def once():
        for n, (model, builds) in cases.items():
            for build in builds:
                begin, figures[0] = process_time(), 0.0
                folder = tmp_path / "fmus" if build == NATIVE else None
                log, told = tmp_path / f"log{n}.csv", _told(model)
                estimate_log(model, log, tmp_path / "out", native=folder, start_values=told)
                drawn[n] = figures[0]
                times[n, build] = np.array([process_time() - begin - figures[0]])

    benchmark.pedantic(once, rounds=1)
    section(
        Section(
            rank=7,
            title=f"A log of {ROWS} rows: n = 2, 4 and 6, r = 1",
            text=(
                "`ndob-fmu estimate` reads a log with jumps, outliers and lost samples, runs the observer along it,"
                " smooths it, and writes the table: a cart on a spring, the flexible joint, three carts in a row. The"
                " native observer is found in its folder by `estimate` itself. The figures are named apart, and"
                " imports are not counted. One run each."
            ),
            ratios=tuple(
                compared(f"n = {n}, {NATIVE}", PYTHON, times[n, NATIVE], times[n, PYTHON])
                for n, (_, builds) in cases.items()
                if PYTHON in builds
            ),
            times=(
                *(Time(f"n = {n}, {build}", float(found[0])) for (n, build), found in times.items()),
                *(Time(f"n = {n}, the three figures", seconds) for n, seconds in drawn.items()),
            ),
        )
    )


def _make(model, path):
    (disturbance,) = model.disturbances
    make_log(
        model,
        path,
        lambda t, _: [3.0 * sin(2.0 * t) + sin(11.0 * t)],
        step=STEP,
        stop_time=STEP * (ROWS - 1),
        disturbances={disturbance: steps(1.5, 0.3, 1, STEP * ROWS)},
        sensors={name: Sensor(NOISE, missing=0.01, outliers=0.001, outlier_size=0.01) for name in model.outputs},
        jitter=0.03,
    )


def _told(model):
    noise = {f"{name}_noise_std": NOISE for name in model.outputs}
    return {**noise, "disturbance_order": 1, "disturbance_rate": 2.0}


def _timed(function, spent: list[float]):
    def timed(*arguments: object, **named: object) -> None:
        begin = process_time()
        function(*arguments, **named)
        spent[0] += process_time() - begin

    return timed
