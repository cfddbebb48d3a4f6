"""Run the numerical tests, and build all that is shipped, under several kernels of OpenBLAS: python -m tests.kernels.

`make test` calls it after the suite, which has run all tests under the kernel of its own environment.

OpenBLAS chooses its kernels by the processor, and their last bits differ. No result, no refusal and no byte of a file
may depend on them. Tunings, transitions and steps (`tests.kernel_numbers`) must agree to 1e-9. Fails by its exit code.
"""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

ROOT = Path(__file__).parents[1]
# The kernels, and the names by which OpenBLAS reports them: it may use Prescott's for Katmai, and say so.
KERNELS = {"Haswell": ("Haswell",), "Sandybridge": ("Sandybridge",), "Prescott": ("Prescott", "Katmai"), "": ()}
NUMERICAL = [
    *(
        f"tests/runtime/test_{name}.py"
        for name in (
            "kalman",
            "stationary_design",
            "tuning",
            "intensity_law",
            "riccati",
            "minimum_phase",
            "exponential",
            "augmented",
            "transition",
        )
    ),
    "tests/analysis/test_certificate.py",
]
# Slow tests that only check the optimum.
_LEFT_OUT = ("-k", "not no_other_intensity")
AGREE_TO = 1e-9
_PROBE = "from tests.kernels import running; print(running())"


def running() -> str:
    """Return the kernels that NumPy runs in this process, as OpenBLAS reports them; empty without OpenBLAS."""
    np.eye(2) @ np.eye(2)
    found = {info["architecture"] for info in threadpool_info() if info["internal_api"] == "openblas"}
    return ", ".join(sorted(found))


def environment(kernel: str) -> dict[str, str]:
    """Return the environment of a process that runs a kernel, or the machine's own for an empty name, in one thread."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS_")}
    return kept | {"OPENBLAS_NUM_THREADS": "1"} | ({"OPENBLAS_CORETYPE": kernel} if kernel else {})


def digest(folder: Path) -> str:
    """Return the SHA-256 of all files in a folder, with their names."""
    whole = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        whole.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return whole.hexdigest()


def run(kernel: str) -> tuple[str, int, str, Mapping[str, Any]]:
    """Return a line about a kernel with what failed, the exit code, the digest of what it built, and its numbers."""

    def call(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, *words]
        return subprocess.run(
            command, env=environment(kernel), cwd=ROOT, capture_output=True, encoding="utf-8", check=False
        )

    name, actual = kernel or "the machine's own", call("-c", _PROBE).stdout.strip()
    if kernel and actual not in KERNELS[kernel]:
        return f"{name}: this processor runs {actual} instead, nothing to test", 0, "", {}
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        shipped = ("flexible_joint", "--out", f"{work}/fmus", "--systems", f"{work}/ssp")
        built = call("-m", "ndob_fmu", "build", *shipped)
        made = digest(Path(work))
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        computed = call("-m", "tests.kernel_numbers", f"{work}/numbers.npz")
        numbers = {} if computed.returncode else dict(np.load(f"{work}/numbers.npz"))
    if actual == running():  # the suite has just run under it
        text, failed = f"{name} ({actual}): tested by the suite, built {made[:12]}", 0
    else:
        tested = call("-m", "pytest", "-q", "-p", "no:cacheprovider", *_LEFT_OUT, *NUMERICAL)
        lines, failed = tested.stdout.strip().splitlines(), tested.returncode
        text = f"{name} ({actual}): {lines[-1] if lines else tested.stderr}, built {made[:12]}"
        text += f"\n{tested.stdout}" if failed else ""
    for done in (built, computed):
        if done.returncode:
            text += f"\n{done.stderr}"
    return text, failed or built.returncode or computed.returncode, made, numbers


def main() -> int:
    """Run all kernels, as many at a time as there are processors; return the exit code."""
    if platform.machine().lower() not in ("x86_64", "amd64") or not running():
        print("kernels: NumPy has no OpenBLAS here whose kernels could be chosen, nothing to switch")
        return 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results, computed = [], []
        for text, code, made, numbers in pool.map(run, KERNELS):
            print(text, flush=True)
            results.append((code, made))
            computed += [numbers] if numbers else []
    difference, where = largest_difference(computed)
    print(f"kernels: the largest difference of tunings, transitions and steps is {difference:.1e} ({where})")
    return max(verdict(results), int(not difference <= AGREE_TO))


def largest_difference(computed: Sequence[Mapping[str, Any]]) -> tuple[float, str]:
    """Return the largest difference of any number from that of the first kernel, and in which array it is."""
    found = (0.0, "none")
    for name in computed[0] if computed else ():
        for other in computed[1:]:
            difference = float(np.max(np.abs(other[name] - computed[0][name])))
            if not difference <= found[0]:
                found = (difference, name)
    return found


def verdict(results: Sequence[tuple[int, str]]) -> int:
    """Return 1 where a kernel's tests failed or kernels built different bytes, and say the latter; else 0."""
    same = len({made for _, made in results if made}) == 1
    if not same:
        print("kernels: expected the same bytes of FMUs and packages under all kernels, received different ones")
    return int(any(code for code, _ in results) or not same)


if __name__ == "__main__":
    sys.exit(main())
