"""The files of an FMU beside its description, code and binaries: icon, manual, licences, what it needs on the host.

Places and names are those of FMI 2.0.3 and later, where licences and external dependencies belong to the documentation.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from ndob_fmu.model import Model
from ndob_fmu.runtime.interface import Variable

Part = Literal["Plant", "Observer"]

_LICENSES = Path(__file__).parent / "licenses"


def extras(model: Model, part: Part, variables: Sequence[Variable]) -> dict[str, bytes]:
    """Return the contents of these files by their path in the archive."""
    texts = {
        "documentation/externalDependencies.txt": _DEPENDENCIES,
        "documentation/licenses/license.txt": _LICENSE.format(name=f"{model.name}{part}"),
    }
    for path in sorted(_LICENSES.glob("*.txt")):
        texts[f"documentation/licenses/{path.name}"] = path.read_text("utf-8")
    return {name: text.encode() for name, text in texts.items()}


_DEPENDENCIES = """This FMU runs Python code and needs on the host

  Python 3.10 or newer, 64 bit, as a shared library (libpython3.so, python3.dll)
  NumPy 1.24 or newer, installed in that Python

The shared library takes the first Python that it finds of
  1. the one that the environment variable NDOB_FMU_PYTHON names,
  2. the one that built the FMU,
  3. the system's.
A host that runs Python itself, such as fmpy, uses its own. Where none is found, or one without NumPy, fmi2Instantiate
logs the reason and returns NULL. Nothing else is needed, neither SciPy nor SymPy nor the package that built the FMU.
"""

_LICENSE = """{name}.fmu contains

  the code that runs the model, in resources/, and the library that loads Python, in binaries/
      ndob-fmu            MIT                 ndob-fmu.txt
  pythonfmu, in resources/pythonfmu/ and binaries/
      pythonfmu           MIT                 pythonfmu.txt
  compiled into the libraries
      FMI 2.0 headers     2-clause BSD        fmi-headers.txt

The model itself, its equations and its parameters, is its author's.
"""
