"""Run the importers that have an environment of their own, and native FMUs in all importers; compare with our master.

    python -m tests.importers.other_importers

The first run installs them into build/importers (1.5 GB). Exit code 1 if one is further from our master than 1e-9. For
native FMUs too, our master runs the Python FMUs; a native plant must give its bits.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from ndob_fmu.model.loading import load_model
from ndob_fmu.native.build import build_native
from tests.helpers.native_host import compile_host
from tests.importers.importer_environments import PINNED
from tests.importers.importer_runs import RUNS, RUNS_IN_ENVIRONMENTS, TOLERANCE, Bench

STEPS = 1000
FMUS = Path(__file__).resolve().parents[2] / "build" / "fmus"


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        folder = Path(work)
        plant, observer = (FMUS / f"FlexibleJoint{kind}.fmu" for kind in ("Plant", "Observer"))
        bench = Bench(plant, observer, FMUS, compile_host(folder), folder, at_most=STEPS)
        native = Bench(*build_native(load_model("flexible_joint"), folder), FMUS, bench.host, folder, bench, STEPS)
        failed = 0
        for study, others in RUNS_IN_ENVIRONMENTS.items():
            tools = [tool for tool in RUNS[study] if tool != "C host"]  # where tests/native runs them
            for build, each, tool in (
                *(("Python", bench, tool) for tool in others),
                *(("native", native, tool) for tool in (*tools, *others)),
            ):
                found = each.difference(tool, study)
                version = f" {PINNED[tool]}" if tool in PINNED else ""
                print(
                    f"{tool}{version}, {build} FMU, {study}: largest difference from our master {found:.0e}", flush=True
                )
                failed += found > (0.0 if (build, study) == ("native", "plant") else TOLERANCE)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
