"""Loading an unpacked FMU's library and making an instance of it."""

from __future__ import annotations

import os
from contextlib import suppress
from ctypes import byref
from pathlib import Path
from typing import Any

import fmpy
from fmpy import fmi2

from ndob_fmu.cosim.fmi.model_description import ModelDescription

_PYTHONFMU = b"PySlaveInstance"  # a class in pythonfmu's library; its name is in the library on every platform


class NoInstanceError(Exception):
    """The FMU cannot be loaded or instantiated; expected, received: for the message."""

    def __init__(self, expected: str, received: str) -> None:
        super().__init__(received)
        self.expected, self.received = expected, received


def instantiate(folder: Path, name: str, description: ModelDescription, callbacks: Any) -> Any:
    """Return a new instance, as fmpy's FMU2Slave, of the FMU that is unpacked in ``folder``.

    callbacks: fmi2CallbackFunctions, which must live as long as the instance. Raises NoInstanceError.
    """
    location, here = _resource_location(folder, description.model_identifier), Path.cwd()
    try:
        fmu = fmi2.FMU2Slave(
            instanceName=name,
            guid=description.guid,
            modelIdentifier=description.model_identifier,
            unzipDirectory=str(folder),
        )
    except Exception as error:  # fmpy raises plain Exception; ctypes AttributeError for a missing function
        raise NoInstanceError("a library that can be loaded", str(error)) from error
    finally:
        os.chdir(here)  # fmpy stays in the library's folder when loading fails
    own_name, guid, uri = (text.encode() for text in (name, description.guid, location))
    reason = "none"
    try:
        fmu.component = fmu.fmi2Instantiate(own_name, fmi2.fmi2CoSimulation, guid, uri, byref(callbacks), False, True)
    except OSError as error:  # on Windows, where other systems end the process
        reason = str(error)
    if fmu.component is None:
        with suppress(OSError):  # on Windows
            fmu.freeLibrary()
        raise NoInstanceError("an instance", reason)
    return fmu


def _resource_location(folder: Path, model_identifier: str) -> str:
    """Return the URI of the FMU's resources in the form that its binary reads.

    pythonfmu's binary decodes no percent code but that of a space, and crashes where a path has another.
    """
    resources = folder / "resources"
    library = folder / "binaries" / fmpy.platform / f"{model_identifier}{fmpy.sharedLibraryExtension}"
    own = (resources / "slavemodule.txt").is_file() and library.is_file()
    if not own or _PYTHONFMU not in library.read_bytes():
        return resources.as_uri()
    if "%20" in str(folder):
        raise NoInstanceError("a folder for temporary files without %20 in its name", str(folder.parent))
    return f"file:///{resources.as_posix().lstrip('/')}"
