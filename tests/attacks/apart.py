"""An attack on FMUs in a process of its own, so that a crash is a result: the FMU's and the trial's, not the tests'."""

from __future__ import annotations

import argparse
import faulthandler
import subprocess
import sys
import tempfile
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from ..fuzz.library import Library

Attack = Callable[[list[Library], int, int, Callable[[str], None]], Counter]


def main(module: str, description: str, attack: Attack, trials: int) -> int:
    """Run the attack with the command line's trials, seed and FMUs; return the exit code, 1 if it found a fault.

    attack(libraries, trials, seed, note) returns counts and raises AssertionError; `note` gets every trial in words
    before it is made.
    """
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=description)
    parser.add_argument("--trials", type=int, default=trials)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fmus", type=Path, required=True, help="folder with the shipped FMUs")
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        faulthandler.enable()
        with (options.inside / "trials").open("w", encoding="utf-8", errors="backslashreplace") as file:

            def note(words: str) -> None:
                file.write(words + "\n")
                file.flush()

            libraries = [Library(folder) for folder in sorted((options.inside / "unpacked").iterdir())]
            counts = attack(libraries, options.trials, options.seed, note)
        for what, count in sorted(counts.items()):
            print(f"{what:60}{count:8}")
        print(f"{options.trials} trials, seed {options.seed}: 0 crashes", flush=True)
        return 0
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        for fmu in sorted(options.fmus.glob("*.fmu")):
            with zipfile.ZipFile(fmu) as archive:
                archive.extractall(Path(work, "unpacked", fmu.stem))
        code = subprocess.run([sys.executable, "-m", module, *sys.argv[1:], "--inside", work], check=False).returncode
        if code:
            last = Path(work, "trials").read_text("utf-8").splitlines()[-1:]
            print(f"exit code {code}; the last trial: {''.join(last)[:2000]}", file=sys.stderr)
    return int(code != 0)
