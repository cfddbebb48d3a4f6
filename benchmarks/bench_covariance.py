"""(h) The cost of a cycle of the observer's FMU while its covariance runs along, and in the dearest cases of that."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial

import numpy as np

from benchmarks.cycle import build_empty, instance, samples_of
from benchmarks.figures import Section, Time, compared
from benchmarks.timing import take_turns
from ndob_fmu import build, load_model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.interface.model_variables import observer_variables

SIGMA = 1e-4  # rad, of both angles
STEPS, FROM = 3000, 1000


def faulty(rows, inputs):
    """Return the rows of inputs of each case; `inputs` of them are u, the others samples."""
    noisy = np.array(rows)
    noisy[:, inputs:] += SIGMA * np.random.default_rng(1).normal(size=noisy[:, inputs:].shape)
    stuck, lost, half_lost = noisy.copy(), noisy.copy(), noisy.copy()
    stuck[FROM:, inputs:] = noisy[FROM, inputs:]
    lost[::7, inputs:] = np.nan
    half_lost[::2, inputs] = np.nan
    return {
        "nothing wrong": noisy,
        "both sensors stuck": stuck,
        "NaN in every seventh sample": lost,
        "one sensor at half the rate": half_lost,
    }


def test_covariance(benchmark, section, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = load_model("flexible_joint")
    equations = compile_model(model)
    observer = build(model, tmp_path)[1]
    empty = build_empty("FlexibleJointObserver", observer_variables(equations), tmp_path)
    told = {f"{y}_noise_std": SIGMA for y in model.outputs}
    cases = faulty(samples_of(model, STEPS), len(model.inputs))
    with ExitStack() as release:
        cycled = {case: release.enter_context(instance(observer, rows.tolist(), told)) for case, rows in cases.items()}
        cycled["empty slave"] = release.enter_context(instance(empty, cases["nothing wrong"].tolist()))
        for one in cycled.values():
            one.run(FROM)
        benchmark.pedantic(lambda: cycled["nothing wrong"].run(1), rounds=1)
        times = take_turns({case: partial(one.run, 1) for case, one in cycled.items()}, STEPS - FROM - 1)
    peer = times.pop("empty slave")
    section(
        Section(
            rank=8,
            title="A cycle of the FMU while its covariance runs along",
            text=(
                "The flexible joint at 1 ms, r = 2, with noise of 0.1 mrad on both angles. Without faults the gain is"
                f" frozen. One cycle is as above; medians over {STEPS - FROM} cycles, and the time that one in"
                " a hundred exceeds."
            ),
            ratios=tuple(compared(f"observer, {case}", "empty slave", t, peer) for case, t in times.items()),
            times=tuple(
                row
                for case, t in times.items()
                for row in (
                    Time(f"{case}, a cycle", float(np.median(t))),
                    Time(f"{case}, one cycle in a hundred", float(np.quantile(t, 0.99))),
                )
            ),
        )
    )
