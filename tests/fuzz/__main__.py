"""python -m tests.fuzz [--calls N] [--seed S] [--fmus FOLDER]: walk, and print how often each call had which status.

The calls are made in a process of their own. If one is answered wrongly or ends that process, the last calls and the
command that repeats them are printed and the exit code is 1.
"""

from __future__ import annotations

import argparse
import faulthandler
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from random import Random

from .library import Library
from .walk import Walk

_SHOWN = 25


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--examples", type=int, default=0, help="of hypothesis, instead of a walk by the seed")
    parser.add_argument("--fmus", type=Path, help="folder with the shipped FMUs; built if it is not given")
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        return inside(options)
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        folder = Path(work)
        for fmu in _fmus(options.fmus, folder):
            with zipfile.ZipFile(fmu) as archive:
                archive.extractall(folder / "unpacked" / fmu.stem)
        command = [sys.executable, "-m", __package__, *sys.argv[1:], "--inside", str(folder)]
        code = subprocess.run(command, check=False).returncode
        if code:
            words = " ".join(sys.argv[1:]) or f"--seed {options.seed}"
            calls = (folder / "calls").read_text("utf-8").splitlines()
            print(
                f"exit code {code} after {len(calls)} calls; the last ones:",
                *calls[-_SHOWN:],
                sep="\n",
                file=sys.stderr,
            )
            print(f"again: python -m tests.fuzz {words}", file=sys.stderr)
    return int(code != 0)


def _fmus(given: Path | None, folder: Path) -> list[Path]:
    """Return a plant, an observer and the components; the reference knows no texts, so none that has one."""
    from ndob_fmu import build, load_model
    from ndob_fmu.fmu.components import records

    numeric = [record for record in records() if all(variable.type != "String" for variable in record.variables)]
    if given:
        names = ("*Plant", "*Observer", *(record.name for record in numeric))
        return sorted(path for name in names for path in given.glob(f"{name}.fmu"))
    return [*build(load_model("flexible_joint"), folder), *(record.build(folder) for record in numeric)]


def inside(options: argparse.Namespace) -> int:
    """Walk in this process, noting every call in a file before it is made."""
    faulthandler.enable()
    libraries = [Library(folder) for folder in sorted((options.inside / "unpacked").iterdir())]
    began = time.monotonic()
    with (options.inside / "calls").open("w", encoding="utf-8") as file:

        def note(words: str) -> None:
            file.write(words + "\n")
            file.flush()

        if options.examples:
            from .machine import explore

            made, counts = explore(libraries, note, options.examples)
        else:
            walk = Walk(libraries, Random(options.seed), note)
            walk.wander(options.calls)
            walk.close()
            made, counts = walk.made, walk.counts
    for (function, status), count in sorted(counts.items()):
        print(f"{function:26}{status:8}{count:8}")
    print(f"{made} calls in {time.monotonic() - began:.1f} s, seed {options.seed}")
    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
