"""Run every study of `importer_runs` in every tool and write what came out into docs/tools.md.

    python -m tests.importers.tools_page

Exit code 1 if a tool is further from our master than 1e-9.
"""

from __future__ import annotations

import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

from fmpy.validation import validate_fmu

from ndob_fmu import build, load_model
from ndob_fmu.packages import build_ssp
from ndob_fmu.support.files import atomic_path
from ndob_fmu.support.shipped import shipped_folder
from tests.helpers.checkers import toolbox_findings
from tests.helpers.native_host import compile_host
from tests.importers.importer_environments import PINNED
from tests.importers.importer_runs import RUNS, RUNS_IN_ENVIRONMENTS, TOLERANCE, Bench

PAGE = Path(__file__).resolve().parents[2] / "docs" / "tools.md"
BEGIN, END = "<!-- written by tests/importers/tools_page.py: begin -->\n", "<!-- end -->\n"
# Each tool with what says its version.
VERSIONS = {
    "fmpy": ("FMPy",),
    "libcosimpy": ("libcosimpy",),
    "ecospy": ("ecospy",),
    "ecos": ("ecospy",),
    "C host": (),
    "fmucontainer": ("fmu-manipulation-toolbox",),
    **dict.fromkeys(PINNED, ()),
}


def all_runs() -> dict[str, tuple[str, ...]]:
    """Return which tools run what, those with an environment of their own among them."""
    return {study: (*tools, *RUNS_IN_ENVIRONMENTS.get(study, ())) for study, tools in RUNS.items()}


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        folder = Path(work)
        plant, observer = build(load_model("flexible_joint"), folder)
        package = build_ssp(shipped_folder("ssp") / "open_loop", folder, folder)
        bench = Bench(plant, observer, package, compile_host(folder), folder)
        cells = {(tool, study): bench.difference(tool, study) for study, tools in all_runs().items() for tool in tools}
        findings = {
            f"fmpy {version('FMPy')}, `fmpy validate`": [*validate_fmu(str(plant)), *validate_fmu(str(observer))],
            f"fmu-manipulation-toolbox {version('fmu-manipulation-toolbox')}, `fmutool -check`": [
                *toolbox_findings(plant),
                *toolbox_findings(observer),
            ],
        }
    lines = [f"| Tool | {' | '.join(RUNS)} |", "|---" * (len(RUNS) + 1) + "|"]
    for tool in VERSIONS:
        shown = " | ".join(_cell(cells.get((tool, study))) for study in RUNS)
        versions = [PINNED[tool]] if tool in PINNED else map(version, VERSIONS[tool])
        lines.append(f"| {' '.join((tool, *versions))} | {shown} |")
    lines += ["", *(f"- {checker}, both FMUs: {len(found)} findings" for checker, found in findings.items())]
    before, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
    with atomic_path(PAGE) as temporary:
        temporary.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + rest.partition(END)[2], "utf-8")
    return int(any(found > TOLERANCE for found in cells.values()) or any(findings.values()))


def _cell(found: float | None) -> str:
    if found is None:
        return "–"
    return f"{found:.0e}" if found else "0"


if __name__ == "__main__":
    sys.exit(main())
