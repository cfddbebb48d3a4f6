"""Damage to files of results: bit flips, cuts, zeroed blocks, exchanged and foreign files.

The folder of a study and that of a run are damaged at random. What `report` reads must then be what was written, or end
in one line; a study that goes on must end with the same table, after the runs in damaged shards were done again.
"""

from __future__ import annotations

import logging
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

import numpy as np
import pyarrow as pa
from pythonfmu.builder import FmuBuilder

from ndob_fmu.errors import MESSAGE_LIMIT, NdobError
from ndob_fmu.report import write_report
from ndob_fmu.results.recording import Recording
from ndob_fmu.results.run_files import read_run, write_run
from ndob_fmu.study import Study, read_study
from ndob_fmu.study.plan import read_plan
from ndob_fmu.study.shards import shard_paths
from ndob_fmu.study.store import Store, read_runs
from ndob_fmu.study.summary import summarize
from ndob_fmu.study.sweep import Tally

from .options import closing_line, read_options

_SLAVE = Path(__file__).parents[1] / "helpers" / "coupling_slaves" / "integrator.py"
_STUDY = """
system = "{system}"
[simulation]
stop_time = 1.0
step_size = 0.5
[grid]
u = [1.0, 2.0, 3.0, 4.0]
[latin_hypercube]
runs = 5
y = {{ from = 1.0, to = {highest} }}
[measures]
end = {{ of = "Integrator.y", take = "final" }}
"""
_TRIALS_FOR_A_REPORT = 50  # making a page takes long


def flip(rng: Random, path: Path, _: Path) -> None:
    data = bytearray(path.read_bytes())
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(data)


def cut(rng: Random, path: Path, _: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: rng.randrange(len(data))])


def zero(rng: Random, path: Path, _: Path) -> None:
    data = path.read_bytes()
    at, size = rng.randrange(len(data)), rng.choice([1, 64, 512, 4096])
    path.write_bytes(data[:at] + bytes(min(size, len(data) - at)) + data[at + size :])


def exchange(rng: Random, path: Path, _: Path) -> None:
    """Exchange two files of a kind."""
    other = rng.choice(sorted(entry for entry in path.parent.iterdir() if entry.is_file()))
    ours, theirs = path.read_bytes(), other.read_bytes()
    path.write_bytes(theirs)
    other.write_bytes(ours)


def bring(rng: Random, path: Path, foreign: Path) -> None:
    """Put the file of another study or run in the place of one, or beside it."""
    source = rng.choice(sorted(foreign.rglob(f"*{path.suffix}")))
    shutil.copyfile(source, rng.choice([path, path.with_name(source.name), path.with_stem(f"{path.stem}_copy")]))


ATTACKS = (flip, flip, flip, cut, zero, exchange, bring)


class Target:
    """A study and a run, and what is in their folders."""

    def __init__(self, folder: Path) -> None:
        FmuBuilder.build_FMU(_SLAVE, folder)
        self.study = _study(folder, "own", 2.0)
        self.results, self.others = folder / "results", folder / "others"
        _finish(self.results, self.study, Random(1))
        _finish(self.others, _study(folder, "other", 3.0), Random(2))
        self.table, self.plan = read_runs(self.results), read_plan(self.results)
        self.run, self.other_run = folder / "run", folder / "other_run"
        for path, scale in ((self.run, 1.0), (self.other_run, 1.1)):
            path.mkdir()
            summary = {"system": "s.ssp", "parameters": {"a.b": scale}, "wall_time": scale}
            write_run(path, _recording(scale), summary, _recording(scale + 1.0))
        self.recording, self.summary, self.inputs = read_run(self.run)

    def damage(self, attack: Callable[[Random, Path, Path], None], rng: Random, work: Path) -> None:
        for name, foreign in (("results", self.others), ("run", self.other_run)):
            shutil.copytree(getattr(self, name), work / name)
            files = [*(work / name).rglob("*.parquet"), *(work / name).glob("*.json"), *(work / name).glob("*.csv")]
            attack(rng, rng.choice(sorted(files)), foreign)

    def read_study(self, work: Path) -> str:
        return "as written" if read_runs(work) == self.table and read_plan(work) == self.plan else "changed"

    def read_run(self, work: Path) -> str:
        recording, summary, inputs = read_run(work)
        same = summary == self.summary and inputs is not None
        same = same and _equal(recording, self.recording) and _equal(inputs, self.inputs)
        return "as written" if same else "changed"

    def go_on(self, work: Path) -> str:
        """Go on with the study, and compare its table with that of the sound one."""
        store = Store(work, self.study)
        missing = np.flatnonzero(~store.finished).tolist()
        if missing:
            store.save(_rows(self.study, missing, Random(1)))
        if read_runs(work) != self.table:
            return "changed"
        return "done again" if missing else "as written"


def _study(folder: Path, name: str, highest: float) -> Study:
    path = folder / f"{name}.toml"
    path.write_text(_STUDY.format(system=(folder / "Integrator.fmu").as_posix(), highest=highest), "utf-8")
    return read_study(path)


def _rows(study: Study, runs: Sequence[int], rng: Random) -> list[dict[str, object]]:
    """Return rows as workers give them; the same run has the same row."""
    ends = [rng.random() for _ in range(len(study.points))]
    return [
        {"run": run, **study.points[run], "end": ends[run], "failed": False, "wall_time": ends[run]} for run in runs
    ]


def _finish(folder: Path, study: Study, rng: Random) -> None:
    store = Store(folder, study)
    state = rng.getstate()
    for first in range(0, len(study.points), 4):
        rng.setstate(state)
        store.save(_rows(study, range(first, first + 4), rng))
    summarize(folder, Tally(len(study.points), 0, 1.0, 1))


def _equal(one: Recording, other: Recording) -> bool:
    arrays = (one.time, other.time), (one.columns, other.columns)
    return one.names == other.names and all(np.array_equal(*pair) for pair in arrays)


def _recording(scale: float) -> Recording:
    time = np.arange(40) * 0.1
    return Recording(time, ("a.x", "b.y"), np.column_stack([np.sin(time), np.cos(time)]) * scale)


def try_one(what: str, action: Callable[[], str]) -> tuple[str, str]:
    """Return what came of reading, and what is wrong with that, if anything."""
    try:
        verdict = action()
    except NdobError as error:
        message = str(error)
        fault = f"said {message!r}" if "\n" in message or len(message) > MESSAGE_LIMIT else ""
        return f"{what}: refused in one line", fault
    except Exception as error:
        return f"{what}: raw exception", repr(error)
    return f"{what}: {verdict}", "a changed table" if verdict == "changed" else ""


def main() -> int:
    options = read_options("tests.attacks.bit_flips", str(__doc__), trials=2000)
    logging.disable(logging.WARNING)  # one line for each damaged folder
    pa.set_cpu_count(1)
    counts = Counter({"changed tables": 0, "raw exceptions": 0})
    faults = []
    with tempfile.TemporaryDirectory() as folder:
        target = Target(Path(folder))
        for trial in range(options.trials):
            rng = Random(f"{options.seed} {trial}")
            work = Path(folder, "work")
            attack = ATTACKS[trial % len(ATTACKS)]
            target.damage(attack, rng, work)
            tried = [
                ("read a run", lambda work=work: target.read_run(work / "run")),
                ("read a study", lambda work=work: target.read_study(work / "results")),
                ("go on with a study", lambda work=work: target.go_on(work / "results")),
            ]
            if trial % _TRIALS_FOR_A_REPORT == 0:
                for name in ("run", "results"):
                    tried.insert(0, ("report", lambda path=work / name: f"of {write_report(path).suffix}"))
            for what, action in tried:
                verdict, fault = try_one(what, action)
                counts[verdict] += 1
                counts["changed tables"] += verdict.endswith("changed")
                counts["raw exceptions"] += verdict.endswith("raw exception")
                if fault:
                    faults.append(f"trial {trial}, {attack.__name__}: {verdict}: {fault}")
            if not shard_paths(work / "results"):
                faults.append(f"trial {trial}: no shards")
            shutil.rmtree(work)
    return closing_line(options, counts, faults)


if __name__ == "__main__":
    raise SystemExit(main())
