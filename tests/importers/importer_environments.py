"""Environments for importers that are large or pin old versions: build/importers/TOOL, made where missing."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import venv
from pathlib import Path

# The versions that were tried; each brings an fmpy of its own.
PINNED = {"gemseo-fmu": "3.1.1", "pathsim-fmi": "0.1.1", "cofmupy": "1.0.0"}
_FOLDER = Path(__file__).resolve().parents[2] / "build" / "importers"


def python_with(tool: str) -> Path:
    """Return the Python of the tool's environment, which is made if it is missing or has another version."""
    wanted = f"{tool}=={PINNED[tool]}"
    folder = _FOLDER / tool
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    stamp = folder / "installed"  # written last, so that an installation that was interrupted is tried again
    if not stamp.is_file() or stamp.read_text("utf-8") != wanted:
        venv.create(folder, clear=True, with_pip=True)
        install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile", wanted]
        if subprocess.run([python, *install], check=False).returncode:
            sys.exit(f"{wanted}: pip cannot install it for Python {platform.python_version()}, see its message above")
        stamp.write_text(wanted, "utf-8")
    return python
