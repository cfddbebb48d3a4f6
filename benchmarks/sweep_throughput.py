"""How many runs a study makes per second: two workers over one, and over fmpy with a new FMU for each run; the memory.

    python -m benchmarks.sweep_throughput [--quick] [--only PART …]

Parts: workers, fresh, memory, study. Ratios are of runs that alternate in one call. `rows(…)` returns what is printed.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import fmpy
import psutil

from ndob_fmu import build, load_model
from ndob_fmu.packages import build_ssp
from ndob_fmu.study import read_study, sweep
from ndob_fmu.study.sweep import Tally
from ndob_fmu.support.shipped import shipped_folder

DEMO = """
system = "open_loop.ssp"
[simulation]
stop_time = 5.0
step_size = 5e-3
[latin_hypercube]
runs = {runs}
observer.pi_end = {{ from = 1e8, to = 1e12, scale = "log" }}
plant.disturbance.amplitude = {{ from = 0.5, to = 4.0 }}
[measures]
error = {{ of = "observer.load_torque_hat", minus = "plant.load_torque_total", take = "rms" }}
"""
PLANT = """
system = "FlexibleJointPlant.fmu"
[simulation]
stop_time = {stop_time}
step_size = 5e-3
[random]
runs = {runs}
disturbance.amplitude = {{ from = 0.5, to = 4.0 }}
[measures]
angle = {{ of = "FlexibleJointPlant.link_angle", take = "final" }}
"""
PARTS = ("workers", "fresh", "memory", "study")


@dataclass(frozen=True)
class Row:
    """One measured figure; required: what it has to be, empty where nothing is required."""

    what: str
    measured: float
    unit: str
    required: str = ""


def rows(parts: Sequence[str] = PARTS, *, quick: bool = False) -> Iterator[Row]:
    """Measure the parts one after the other; quick: with too few runs to mean anything, as a smoke test."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build(load_model("flexible_joint"), folder)
        build_ssp(shipped_folder("ssp") / "open_loop", folder, folder)
        if "workers" in parts:
            yield from _workers(folder, runs=4 if quick else 60, rounds=1 if quick else 3)
        if "fresh" in parts:
            yield from _fresh(folder, runs=20 if quick else 1000, fresh=3 if quick else 60)
        if "memory" in parts:
            yield from _memory(folder, runs=2000 if quick else 10_000)
        if "study" in parts:
            yield from _study(folder, runs=4 if quick else 2000)


def _sweep(folder: Path, text: str, workers: int, results: Path | None = None) -> Tally:
    (folder / "study.toml").write_text(text, "utf-8")
    study = read_study(folder / "study.toml")
    with tempfile.TemporaryDirectory() as temporary:
        return sweep(study, results or temporary, workers=workers, progress=False)


def _workers(folder: Path, *, runs: int, rounds: int) -> Iterator[Row]:
    tallies = [[_sweep(folder, DEMO.format(runs=runs), workers) for workers in (1, 2)] for _ in range(rounds)]
    one, two = (median(t.done / t.seconds for t in column) for column in zip(*tallies, strict=True))
    yield Row("two workers over one, demo for 5 s at 5 ms", two / one, "×", "≥ 1.8")
    yield Row("one worker, demo for 5 s at 5 ms", one, "runs/s")


def _fresh(folder: Path, *, runs: int, fresh: int) -> Iterator[Row]:
    path, stop_time = folder / "FlexibleJointPlant.fmu", 0.5
    rates = []
    for workers in (1, 2):
        tally = _sweep(folder, PLANT.format(runs=runs, stop_time=stop_time), workers)
        began = time.perf_counter()
        for k in range(fresh):
            fmpy.simulate_fmu(
                path,
                stop_time=stop_time,
                step_size=5e-3,
                output_interval=5e-3,
                start_values={"disturbance.amplitude": 0.5 + k / fresh},
            )
        rates.append((tally.done / tally.seconds, fresh / (time.perf_counter() - began)))
    (one, peer), (two, peer_again) = rates
    yield Row("two workers over fmpy.simulate_fmu afresh, plant, 100 steps", two / peer_again, "×", "≥ 6")
    yield Row("one worker over fmpy.simulate_fmu afresh, plant, 100 steps", one / peer, "×")
    yield Row("fmpy.simulate_fmu afresh, plant, 100 steps", peer_again, "runs/s")


def _memory(folder: Path, *, runs: int) -> Iterator[Row]:
    samples: list[tuple[int, int, int]] = []
    done, own, results = threading.Event(), psutil.Process(), folder / "memory"

    def watch() -> None:
        while not done.wait(0.2):
            with suppress(psutil.Error):  # of a worker that is just ending
                children = sum(child.memory_info().rss for child in own.children(recursive=True))
                samples.append((_finished(results), own.memory_info().rss, children))

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        _sweep(folder, PLANT.format(runs=runs, stop_time=0.05), 2, results)
    finally:
        done.set()
        watcher.join()
    samples = [sample for sample in samples if runs // 5 <= sample[0] < runs]  # all loaded, nobody on the way out
    early, late = samples[0], samples[-1]
    for k, who in ((1, "command"), (2, "two workers")):
        yield Row(f"growth of the {who}, run {early[0]} to {late[0]}", (late[k] - early[k]) / 2**20, "MiB", "flat")
        yield Row(f"memory of the {who} then", late[k] / 2**20, "MiB")


def _finished(results: Path) -> int:
    spans = [path.stem.split("_")[1:] for path in (results / "shards").glob("runs_*.parquet")]
    return sum(int(last) - int(first) + 1 for first, last in spans)


def _study(folder: Path, *, runs: int) -> Iterator[Row]:
    tally = _sweep(folder, DEMO.format(runs=runs), 2)
    yield Row(f"{runs} runs of the demo for 5 s at 5 ms, two workers", tally.seconds, "s")
    yield Row("its rate", tally.done / tally.seconds, "runs/s")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        description=str(__doc__).partition("\n")[0], prog="python -m benchmarks.sweep_throughput"
    )
    parser.add_argument("--quick", action="store_true", help="few runs, as a smoke test")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=", ".join(PARTS))
    given = parser.parse_args(arguments)
    for row in rows(given.only, quick=given.quick):
        required = f"   required {row.required}" if row.required else ""
        print(f"{row.what:62} {row.measured:10.4g} {row.unit}{required}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
