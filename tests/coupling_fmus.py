"""Small FMUs for the tests of the coupling, built once per session from `coupling_slaves/` by a stock pythonfmu."""

from __future__ import annotations

import functools
from pathlib import Path

from pythonfmu.builder import FmuBuilder

SLAVES = Path(__file__).parent / "coupling_slaves"


@functools.cache
def coupling_fmus(session_folder: Path) -> Path:
    """Return the folder with Integrator.fmu, Gain.fmu, MassSpring.fmu, Mirror.fmu and Fragile.fmu."""
    folder = session_folder / "coupling_fmus"
    for script in sorted(SLAVES.glob("*.py")):
        FmuBuilder.build_FMU(script, folder)
    return folder
