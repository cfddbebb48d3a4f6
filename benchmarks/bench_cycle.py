"""(a) The cost of a cycle of the observer's FMU, compared with an FMU that does nothing."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
import pytest

from benchmarks.cycle import cycles
from benchmarks.figures import Section, Time, compared
from benchmarks.models import carts
from benchmarks.timing import take_turns
from ndob_fmu import load_model

COUNT, ROUNDS = 200, 150


@pytest.mark.parametrize(
    ("model", "name", "required"),
    [(load_model("flexible_joint"), "n = 4, r = 2", 1.3), (carts(8), "n = 16, sparse, r = 2", 2.0)],
    ids=["joint", "carts"],
)
def test_cycle(benchmark, section, tmp_path, monkeypatch, model, name, required):
    monkeypatch.chdir(tmp_path)
    with ExitStack() as release:
        actions = cycles(model, tmp_path, release, COUNT, ROUNDS + 1)
        benchmark.pedantic(actions["observer"], rounds=1)
        actions["empty slave"]()
        times = take_turns(actions, ROUNDS)
    section(
        Section(
            rank=1,
            title=f"A cycle of the FMU: {name}",
            text=(
                "One cycle is setReal of all inputs, doStep and getReal of all Real outputs through fmpy's "
                "FMU2Slave. The observer's gain has converged, and its samples come from its plant under a sine. "
                "The empty slave is a stock FMU of pythonfmu with the same variables as attributes; its do_step "
                f"only returns. {COUNT} cycles of each in turn, {ROUNDS} times."
            ),
            ratios=(compared(f"observer, {name}", "empty slave", times["observer"], times["empty slave"], required),),
            times=tuple(Time(f"{who}, a cycle", float(np.median(t)) / COUNT) for who, t in times.items()),
        )
    )
