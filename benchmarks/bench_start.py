"""(e) The costs that occur once: building the FMUs, loading one, and the design at the first step."""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest

from benchmarks.cycle import STEP, instance, samples_of
from benchmarks.figures import Section, Time
from benchmarks.models import carts
from ndob_fmu import build, load_model

ROUNDS = 5
MODELS = {
    "the paper's joint, n = 4": lambda: load_model("flexible_joint"),
    "carts, n = 16": lambda: carts(8),
    "carts, n = 32": lambda: carts(16),
}


@pytest.mark.parametrize("name", MODELS)
def test_start(benchmark, section, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    samples = samples_of(MODELS[name](), 2)
    times = {"build of both FMUs": [], "first step, with the design for its length": [], "second step": []}

    def once():
        with_nothing_done = MODELS[name]()  # a model keeps its equations once they are written
        begin = process_time()
        _, observer = build(with_nothing_done, tmp_path)
        times["build of both FMUs"].append(process_time() - begin)
        with instance(observer, samples) as cycled:
            for step in ("first step, with the design for its length", "second step"):
                begin = process_time()
                cycled.run(1)
                times[step].append(process_time() - begin)

    benchmark.pedantic(once, rounds=ROUNDS)
    section(
        Section(
            rank=4,
            title=f"Once: {name}",
            text=(
                f"A design is made at the first step, which is the first to know its length ({STEP:g} s). Until the "
                "gain has converged, a step also updates the covariance, in NumPy; the second step is such a step. "
                f"Medians of {ROUNDS} rounds."
            ),
            times=tuple(Time(what, float(np.median(found))) for what, found in times.items()),
        )
    )
