"""(h) Native FMUs over the same FMUs in Python: the demo in our master, and a run of a study."""

from __future__ import annotations

import numpy as np

from benchmarks.figures import Section, Time, compared
from benchmarks.timing import take_turns
from ndob_fmu import build, load_model
from ndob_fmu.cosim import simulate
from ndob_fmu.native.build import build_native
from ndob_fmu.packages import build_ssp
from ndob_fmu.study import read_study
from ndob_fmu.study.session import Session
from ndob_fmu.support.shipped import shipped_folder

ROUNDS = 7
DEMO, RUN = "the demo, method 2", "a run of a study, method 2"
REQUIRED = {DEMO: 0.25}
STUDY = """
system = "python/open_loop.ssp"
[simulation]
stop_time = 5.0
step_size = 5e-3
[fixed]
observer.method = 2
[grid]
plant.disturbance.amplitude = [1.0, 2.0]
[measures]
error = { of = "observer.load_torque_hat", minus = "plant.load_torque_total", take = "rms" }
"""
TEXT = (
    "The demo is plant and observer coupled over 20 000 steps in our master, from the path of the package to the "
    "recorded signals, loading the FMUs included. A run of the study is 1000 steps of 5 ms with method 2, of FMUs that "
    f"are loaded. The same calls for both builds, in turns in one process, {ROUNDS} rounds. The native FMUs are those "
    "that `ndob-fmu build --target native` makes with the system's compiler or zig's."
)


def test_native_systems(benchmark, section, tmp_path):
    model, packages = load_model("flexible_joint"), {}
    for name, builder in (("python", build), ("native", build_native)):
        builder(model, tmp_path / name)
        packages[name] = build_ssp(shipped_folder("ssp") / "open_loop", tmp_path / name, tmp_path / name)
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    studies = {name: read_study(tmp_path / "study.toml", path) for name, path in packages.items()}
    sessions = {name: Session(study, {study.system: packages[name]}) for name, study in studies.items()}
    actions = {
        (DEMO, name): lambda path=path: simulate(path, start_values={"observer.method": 2})
        for name, path in packages.items()
    }
    actions |= {(RUN, name): lambda one=session: one.run(0) for name, session in sessions.items()}
    for session in sessions.values():
        session.run(0)
    found = benchmark.pedantic(take_turns, args=(actions, ROUNDS), rounds=1)
    section(
        Section(
            rank=2,
            title="Native FMUs in our master",
            text=TEXT,
            ratios=tuple(
                compared(
                    f"native FMUs, {what}",
                    "FMUs in Python",
                    found[what, "native"],
                    found[what, "python"],
                    REQUIRED.get(what),
                )
                for what in (DEMO, RUN)
            ),
            times=tuple(
                Time(f"{what}, {'native FMUs' if name == 'native' else 'FMUs in Python'}", float(np.median(times)))
                for (what, name), times in found.items()
            ),
        )
    )
    for session in sessions.values():
        session.close()
