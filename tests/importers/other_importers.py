"""Run the importers that have an environment of their own, and compare them with our master.

    python -m tests.importers.other_importers

The first run installs them into build/importers (1.5 GB). Exit code 1 if one is further from our master than 1e-9.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.helpers.native_host import compile_host
from tests.importers.importer_environments import PINNED
from tests.importers.importer_runs import RUNS_IN_ENVIRONMENTS, TOLERANCE, Bench

FMUS = Path(__file__).resolve().parents[2] / "build" / "fmus"


def main() -> int:
    worst = 0.0
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        plant, observer = (FMUS / f"FlexibleJoint{kind}.fmu" for kind in ("Plant", "Observer"))
        bench = Bench(plant, observer, FMUS, compile_host(Path(work)), Path(work))
        for study, tools in RUNS_IN_ENVIRONMENTS.items():
            for tool in tools:
                found = bench.difference(tool, study)
                print(f"{tool} {PINNED[tool]}, {study}: largest difference from our master {found:.0e}", flush=True)
                worst = max(worst, found)
    return int(worst > TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
