"""(f) The observer over a recorded log beside a loop that only calls it, and the memory for a CSV file."""

from __future__ import annotations

import numpy as np

from benchmarks.figures import Ratio, Section, Time, compared
from benchmarks.input_log import bare, memory_of_csv, ours, record
from benchmarks.timing import take_turns
from ndob_fmu import build, load_model
from ndob_fmu.packages import build_ssp
from ndob_fmu.support.shipped import shipped_folder

ROUNDS = 7
TEXT = (
    "The observer's FMU reads the samples of a CSV file of 25 000 rows and records its outputs. The bare loop reads "
    "the same file, makes the same FMI calls through fmpy's functions and records nothing. The memory is that of a "
    "process that writes 200 000 rows of 100 signals as CSV: its peak above the recording, over the recording's "
    "160 MB; the bound is 100 MB."
)


def test_input_log(benchmark, section, tmp_path):
    plant, observer = build(load_model("flexible_joint"), tmp_path)
    system = build_ssp(shipped_folder("ssp") / "open_loop", plant.parent, tmp_path)
    replay = record(system, observer, tmp_path / "log.csv")
    found = {}

    def once():
        found.update(take_turns({"ours": lambda: ours(replay), "bare loop": lambda: bare(replay)}, ROUNDS))

    benchmark.pedantic(once, rounds=1)
    memory = memory_of_csv()
    share = memory.above / memory.recording
    section(
        Section(
            rank=6,
            title="Logs and files",
            text=TEXT,
            ratios=(
                compared("simulate over a log of 25 000 rows", "bare loop", found["ours"], found["bare loop"], 1.2),
                Ratio(
                    "memory for a recording as CSV",
                    "the recording",
                    share,
                    share,
                    share,
                    100e6 / 160e6,
                ),
            ),
            times=tuple(Time(name, float(np.median(times))) for name, times in found.items()),
        )
    )
