"""Run programs in a new process without access to this package, as on the machine of a user of an FMU."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

# An FMU brings its own code and needs NumPy; these would be found in the environment of the tests, but not elsewhere.
_ABSENT = ("ndob_fmu", "fmus", "scipy", "sympy", "pint", "matplotlib")
_HIDE = f"import sys; sys.modules.update(dict.fromkeys({_ABSENT!r}));"
# pythonfmu's static state can abort a process as it exits, after a correct run; so a finished program ends by os._exit.
_LEAVE = "\nimport os, sys; sys.stdout.flush(); sys.stderr.flush(); os._exit(0)\n"
_KEPT = ("PATH", "HOME", "LANG", "TMPDIR", "SYSTEMROOT", "TEMP")
ENVIRONMENT = {name: os.environ[name] for name in _KEPT if name in os.environ}


def run_clean(
    program: str, *arguments: str | Path, cwd: Path, timeout: float = 120.0
) -> subprocess.CompletedProcess[str]:
    """Run a Python program with these command line arguments; it cannot import the package."""
    return subprocess.run(
        [sys.executable, "-I", "-c", f"{_HIDE}{program}{_LEAVE}", *map(str, arguments)],
        cwd=cwd,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def fmpy(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run fmpy's command line in the same way."""
    return run_clean("from fmpy.cli import main; main()", *arguments, cwd=cwd)
