"""(b) The demo in our master, in libcosim and ecos, and in a loop that only calls the FMUs."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.coupling import TOOLS, Job, spent
from benchmarks.figures import Section, Time, compared
from ndob_fmu import build, load_model
from ndob_fmu.packages import build_ssp
from ndob_fmu.support.shipped import shipped_folder

ROUNDS = {1: 3, 2: 7}
METHODS = {1: "method 1, the paper's, as shipped", 2: "method 2, the sampled-data design"}
PEERS = {
    "bare loop": 1.2,
    "libcosimpy": 1.0,
    "ecospy": 1.0,
    "libcosimpy, records nothing": None,
    "ecospy, records nothing": None,
}
CLOCKS = ("on the clock", "of the processors")
TEXT = (
    "Plant and observer coupled over 20 000 steps, from the path of the package to the recorded signals. Each tool "
    "runs in a process of its own, and imports are not counted; libcosim and ecos run their own loops in C++. Our "
    "master records all outputs in memory, libcosim every Real output in memory, ecos every one in a CSV file; the "
    "runs that record nothing are a lower bound for these two. The bare loop makes the same FMI calls through "
    "fmpy's functions (doStep, set of the samples, get of all Real outputs and of `valid`). It allocates memory "
    "once, so that the observer reads the samples where the plant has written them, and records nothing. The bounds"
    " are for processor time, because other work on the machine disturbs the clock."
)


@pytest.mark.parametrize("method", METHODS)
def test_coupling(benchmark, section, tmp_path, method):
    model = load_model("flexible_joint")
    # ecos and libcosim set no enumerations of the package: the method is the FMU's own start value.
    model = replace(model, observer=replace(model.observer, method=method))
    plant, observer = build(model, tmp_path)
    source = shutil.copytree(shipped_folder("ssp") / "open_loop", tmp_path / "open_loop")
    values = source / "observer.ssv"
    shipped = '<ssv:Parameter name="method">\n      <ssv:Integer value="1"/>\n    </ssv:Parameter>'
    assert shipped in values.read_text("utf-8")
    values.write_text(values.read_text("utf-8").replace(shipped, ""), "utf-8")
    job = Job(str(build_ssp(source, tmp_path, tmp_path)), str(plant), str(observer))
    rounds = []

    def once():
        turns = list(TOOLS)[len(rounds) % len(TOOLS) :] + list(TOOLS)[: len(rounds) % len(TOOLS)]
        found = {tool: spent(tool, job, tmp_path) for tool in turns}
        rounds.append([found[tool] for tool in TOOLS])

    benchmark.pedantic(once, rounds=ROUNDS[method])
    times = {tool: np.array(rounds)[:, i] for i, tool in enumerate(TOOLS)}
    section(
        Section(
            rank=2,
            title=f"The demo, 20 s at 1 ms: {METHODS[method]}",
            text=f"{TEXT} {len(rounds)} rounds.",
            ratios=tuple(
                compared(f"our master, method {method}, {of}", tool, times["ours"][:, i], times[tool][:, i], bound)
                for tool, required in PEERS.items()
                for i, (of, bound) in enumerate(zip(CLOCKS, (None, required), strict=True))
            ),
            times=tuple(
                Time(f"{tool}, {of}", float(np.median(times[tool][:, i])))
                for tool in TOOLS
                for i, of in enumerate(CLOCKS)
            ),
        )
    )
