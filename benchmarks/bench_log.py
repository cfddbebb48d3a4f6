"""(j) `ndob-fmu estimate` over a log of 25 000 rows: the steps in Python and by the native observer."""

from __future__ import annotations

from math import sin
from time import process_time

import numpy as np

from benchmarks.figures import Section, Time, compared
from ndob_fmu import load_model
from ndob_fmu.log import estimate_log as estimate_module
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.made_log import Sensor, make_log, steps
from ndob_fmu.native.build import build_native

ROWS, STEP = 25_000, 2e-3
NOISE = {"motor_angle": 1e-4, "link_angle": 1e-4}
TOLD = {
    **{f"{name}_noise_std": std for name, std in NOISE.items()},
    "disturbance_order": 1,
    "disturbance_rate": 2.0,
}
NATIVE, PYTHON = "estimate, native observer", "estimate, observer in Python"


def test_log(benchmark, section, tmp_path, monkeypatch):
    joint, log = load_model("flexible_joint"), tmp_path / "log.csv"
    make_log(
        joint,
        log,
        lambda t, _: [3.0 * sin(2.0 * t) + sin(11.0 * t)],
        step=STEP,
        stop_time=STEP * (ROWS - 1),
        disturbances={"load_torque": steps(1.5, 0.3, 1, STEP * ROWS)},
        sensors={name: Sensor(std, missing=0.01, outliers=0.001, outlier_size=0.01) for name, std in NOISE.items()},
        jitter=0.03,
    )
    build_native(joint, tmp_path / "fmus")
    figures = [0.0]
    monkeypatch.setattr(estimate_module, "write_figures", _timed(estimate_module.write_figures, figures))
    times = {what: np.zeros(1) for what in (NATIVE, PYTHON)}

    def once():
        for what, native in ((NATIVE, tmp_path / "fmus"), (PYTHON, None)):
            begin, figures[0] = process_time(), 0.0
            estimate_log(joint, log, tmp_path / "out", native=native, start_values=TOLD)
            times[what][0] = process_time() - begin - figures[0]

    benchmark.pedantic(once, rounds=1)
    section(
        Section(
            rank=7,
            title=f"A log of {ROWS} rows: n = 4, r = 2",
            text=(
                "`ndob-fmu estimate` reads the log of the flexible joint, runs the observer along it, smooths it, and"
                " writes the table. The native observer is found in its folder by `estimate` itself. The figures are"
                " named apart, and imports are not counted. One run each."
            ),
            ratios=(compared(NATIVE, PYTHON, times[NATIVE], times[PYTHON]),),
            times=(
                *(Time(what, float(found[0])) for what, found in times.items()),
                Time("the three figures", figures[0]),
            ),
        )
    )


def _timed(function, spent: list[float]):
    def timed(*arguments: object, **named: object) -> None:
        begin = process_time()
        function(*arguments, **named)
        spent[0] += process_time() - begin

    return timed
