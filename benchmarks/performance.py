"""Run the benchmarks, all files `bench_*.py` of this folder, and write what they found as a page.

    python -m benchmarks.performance [--out DIR] [WORDS FOR PYTEST …]

writes `performance.md` into DIR, by default `docs`. `python -m pytest benchmarks/bench_core.py` runs one of them.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.figures import Section
from benchmarks.performance_page import text
from ndob_fmu.support.files import atomic_path

HERE = Path(__file__).parent


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        description=str(__doc__).partition("\n")[0], prog="python -m benchmarks.performance"
    )
    parser.add_argument("--out", type=Path, default=HERE.parent / "docs", help="default: docs")
    given, words = parser.parse_known_args(arguments)
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as folder:
        found = Path(folder, "found.json")
        command = [sys.executable, "-m", "pytest", str(HERE), "--quiet", f"--benchmark-json={found}", *words]
        done = subprocess.run(command, cwd=HERE.parent, check=False)
        if done.returncode:
            return done.returncode
        benchmarks = json.loads(found.read_text("utf-8"))["benchmarks"]
    sections = [Section.from_dict(benchmark["extra_info"]["section"]) for benchmark in benchmarks]
    with atomic_path(given.out / "performance.md") as temporary:
        temporary.write_text(text(sections), "utf-8", newline="\n")
    print(given.out / "performance.md")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
