"""SIGTERM, and Ctrl-C twice, at random times through `simulate` and `sweep`: nothing is left behind, nothing half-done.

After each attack the folder for temporary files and the working folder are empty but for whole results, no process is
left, and the command has ended in time, without a traceback. Each trial is one SIGTERM and one double Ctrl-C.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from random import Random

import psutil
from pythonfmu.builder import FmuBuilder

from ndob_fmu.errors import NdobError
from ndob_fmu.results.run_files import read_run
from ndob_fmu.study.store import read_runs

from .options import closing_line, read_options

_SLAVE = Path(__file__).parents[1] / "helpers" / "coupling_slaves" / "fragile.py"
_STUDY = """
system = "Fragile.fmu"
[simulation]
stop_time = 3.0
step_size = 1.0
[fixed]
how = "slow"
[list]
fails_at = { from = 0.0, to = 1e-6, values = 60 }
"""
_COMMANDS = {
    "simulate": ["simulate", "Fragile.fmu", "--stop-time", "30", "--step-size", "1", "--results", "results"],
    "sweep": ["sweep", "study.toml", "--out", "results", "--workers", "2"],
}
_COMMANDS["simulate"] += ["--start-values", "how", "slow"]
_LONGEST = 60.0  # seconds for a command to end
_INPUTS = {"Fragile.fmu", "study.toml"}


class Place:
    """A working folder, one for temporary files, and the command that runs there."""

    def __init__(self, folder: Path, fmu: Path, command: str) -> None:
        self.work, self.temporary = folder / "work", folder / "temporary"
        self.work.mkdir(parents=True)
        self.temporary.mkdir()
        (self.work / "Fragile.fmu").write_bytes(fmu.read_bytes())
        (self.work / "study.toml").write_text(_STUDY, "utf-8")
        self.output = (self.work.parent / "output").open("w+")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "ndob_fmu", *_COMMANDS[command]],
            cwd=self.work,
            env=os.environ | {"TMPDIR": str(self.temporary), "PYTHONPATH": str(Path(__file__).parents[2])},
            stdout=self.output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    def ended(self) -> list[str]:
        """Wait for the end, and return what is wrong then."""
        try:
            code = self.process.wait(_LONGEST)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            return [f"did not end within {_LONGEST} s"]
        faults = [f"left the process {' '.join(process.cmdline())[:100]}" for process in self._left()]
        faults += [f"left {path.relative_to(self.work.parent)}" for path in self.temporary.rglob("*")][:5]
        faults += [f"left {path.name}" for path in self.work.iterdir() if path.name not in _INPUTS | {"results"}]
        results = self.work / "results"
        files = [path for path in results.rglob("*") if path.is_file()]
        hidden = [path.name for path in files if path.name.startswith(".") and path.name != ".lock"]
        faults += [f"left {name} in the results" for name in hidden]
        faults += self._partial(results)
        self.output.seek(0)
        said = self.output.read()
        began = ", in run_and_leave" in said or not said.rstrip().endswith("KeyboardInterrupt")
        if "Traceback" in said and began:  # before that Python itself was starting
            faults.append(f"printed {said[-600:]!r}")
        self.output.close()
        if code not in (0, 128 + signal.SIGTERM, 128 + signal.SIGINT, -signal.SIGTERM, -signal.SIGINT):
            faults.append(f"ended with {code}, said {said[-600:]!r}")
        return faults

    def _left(self) -> list[psutil.Process]:
        end = time.monotonic() + 10.0  # workers take a moment to notice
        while time.monotonic() < end:
            found = [process for process in psutil.process_iter() if _session(process) == self.process.pid]
            if not found:
                return []
            time.sleep(0.1)
        return found

    def _partial(self, results: Path) -> list[str]:
        try:
            if (results / "shards").exists():
                read_runs(results)
            elif (results / "result.csv").exists():
                read_run(results)
                return [f"no {name}" for name in ("summary.json", "signals.svg") if not (results / name).exists()]
            elif results.exists() and {path.name for path in results.iterdir()} - {".lock", "study.json", "system.svg"}:
                return [f"a part of the results: {sorted(path.name for path in results.iterdir())}"]
        except NdobError as error:
            return [f"left damaged results: {error}"]
        return []


def _session(process: psutil.Process) -> int:
    try:
        return os.getsid(process.pid)
    except OSError:
        return 0


def interrupt(place: Place, kind: str, rng: Random) -> None:
    """Send the signals: SIGTERM to the command, as `kill` does; Ctrl-C to all its processes, as a terminal does."""
    if kind == "SIGTERM":
        place.process.terminate()
        return
    for pause in (0.0, rng.choice([0.0, 0.01, rng.uniform(0.0, 1.0)])):
        time.sleep(pause)
        if place.process.poll() is None:
            os.killpg(place.process.pid, signal.SIGINT)


def main() -> int:
    options = read_options("tests.attacks.interrupts", str(__doc__), trials=20)
    counts: Counter[str] = Counter()
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        FmuBuilder.build_FMU(_SLAVE, name)
        durations: dict[str, float] = {}
        for command in list(_COMMANDS)[: options.trials]:
            begin = time.monotonic()
            place = Place(Path(name, command), Path(name, "Fragile.fmu"), command)
            faults += [f"{command}, not interrupted: {fault}" for fault in place.ended()]
            durations[command] = time.monotonic() - begin
        for trial in range(options.trials):
            rng = Random(f"{options.seed} {trial}")
            command = list(_COMMANDS)[trial % 2]
            for kind in ("SIGTERM", "double Ctrl-C"):
                after, attempt = rng.uniform(0.0, durations[command]), 0
                while True:
                    place = Place(Path(name, f"{trial} {kind} {attempt}"), Path(name, "Fragile.fmu"), command)
                    time.sleep(after)
                    if place.process.poll() is None:
                        break
                    place.output.close()  # too late: the machine is faster now
                    after, attempt = 0.7 * after, attempt + 1
                counts[kind] += 1
                interrupt(place, kind, rng)
                faults += [f"trial {trial}, {command}, {kind} after {after:.2f} s: {fault}" for fault in place.ended()]
    return closing_line(options, counts, faults)


if __name__ == "__main__":
    raise SystemExit(main())
