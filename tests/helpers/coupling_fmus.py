"""Small FMUs for the tests of the coupling, built once per session from `coupling_slaves/` by a stock pythonfmu."""

from __future__ import annotations

import functools
import os
import shlex
import subprocess
import zipfile
from pathlib import Path

import fmpy
from pythonfmu.builder import FmuBuilder

from tests.helpers.needs import found_c_compiler

SLAVES = Path(__file__).parent / "coupling_slaves"


@functools.cache
def coupling_fmus(session_folder: Path) -> Path:
    """Return the folder with Integrator, Gain, MassSpring, Mirror and Fragile.fmu, and with a C compiler Ramp.fmu."""
    folder = session_folder / "coupling_fmus"
    for script in sorted(SLAVES.glob("*.py")):
        FmuBuilder.build_FMU(script, folder)
    if found_c_compiler():
        _compile("Ramp", folder)
    return folder


def _compile(name: str, folder: Path) -> None:
    """Build an FMU from C: pythonfmu's FMUs end a simulation at the beginning of a step only."""
    source, library = SLAVES / f"{name.lower()}.c", folder / f"{name}{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    compiler = shlex.split(os.environ.get("CC", "cc"))
    subprocess.run([*compiler, "-shared", "-fPIC", "-O1", f"-I{headers}", source, "-o", library, "-lm"], check=True)
    with zipfile.ZipFile(folder / f"{name}.fmu", "w") as fmu:
        fmu.write(source.with_suffix(".xml"), "modelDescription.xml")
        fmu.write(library, f"binaries/{fmpy.platform}/{library.name}")
    library.unlink()
