"""The front of an FMU on Linux: a small C library that lets native hosts load what pythonfmu built.

It lies where the host looks for the FMU's binary, pythonfmu's own beside it, and its sources in `front/`. Compiled
here with the system's compiler; without one the FMU keeps pythonfmu's binary in its place, and what the front does is
lost.
"""

from __future__ import annotations

import functools
import logging
import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import fmpy
import numpy as np

_log = logging.getLogger(__name__)

SOURCES = Path(__file__).parent / "front"
HEADERS = Path(fmpy.__file__).parent / "c-code"
SLAVE_BINARY = "binaries/linux64/pythonfmu-export.so"
DESCRIPTION = "resources/front.txt"

_LOST = (
    "the FMUs get no front for Linux: they load in Python processes only, guard no calls and must not lie in a folder "
    "with ä # + [ ( , ' in its name; %s"
)
# No path, no time and no name of this machine goes into the binary; -s drops the names of temporary files.
_FLAGS = (
    "-std=gnu11",
    "-O2",
    "-fPIC",
    "-shared",
    "-Wl,-z,nodelete",  # ecos closes the library while instances of it live on
    "-fvisibility=hidden",
    "-Wall",
    "-Wextra",
    "-Wl,--build-id=none",
    "-s",
)
_TYPES = {"Real": "R", "Integer": "I", "Enumeration": "I", "Boolean": "B", "String": "S"}


def with_front(contents: Mapping[str, bytes], root: ET.Element) -> dict[str, bytes]:
    """Return the FMU's files with the front before pythonfmu's binary; `root` is the finished model description.

    Off x86-64 Linux, and with a warning where nothing compiles, the files are returned as they are.
    """
    simulation = root.find("CoSimulation")
    if simulation is None:
        raise LookupError("pythonfmu wrote a model description without <CoSimulation>")
    binary = f"binaries/linux64/{simulation.get('modelIdentifier')}.so"
    front = compiled() if (sys.platform, platform.machine()) == ("linux", "x86_64") else None
    if front is None:
        return dict(contents)
    return {
        **contents,
        binary: front,
        SLAVE_BINARY: contents[binary],
        DESCRIPTION: description(root, contents).encode(),
    }


def description(root: ET.Element, contents: Mapping[str, bytes]) -> str:
    """Return front.txt: what the front has to know of the FMU and its files, and the Python that it tries first."""
    files = [name.removeprefix("resources/") for name in contents if name.startswith("resources/")]
    lines = [
        f"guid={root.get('guid')}",
        *(f"{name}={path}" for name, path in building_python().items()),
        f"entry={contents['resources/slavemodule.txt'].decode().strip()}",
        f"files={'|'.join(sorted(files))}",
    ]
    by_reference = {int(element.get("valueReference", "")): element for element in root.iterfind("ModelVariables/*")}
    if sorted(by_reference) != list(range(len(by_reference))):
        raise LookupError("pythonfmu wrote value references that do not count from 0")
    for _, element in sorted(by_reference.items()):
        lines.append(f"variable={_TYPES[element[0].tag]}{_role(element)} {element.get('name')}")
    lines.append(f"variables={len(by_reference)}")
    return "\n".join(lines) + "\n"


def _role(element: ET.Element) -> str:
    causality = element.get("causality")
    if causality == "parameter":
        return "t" if element.get("variability") == "tunable" else "f"
    return "i" if causality == "input" else "o"


def building_python() -> dict[str, str]:
    """Return executable, libpython and the folder that NumPy lies in; empty where there is none."""
    value = sysconfig.get_config_var
    folders = [value("LIBDIR"), str(Path(sys.base_prefix) / "lib")]
    names = [name for name in (value("INSTSONAME"), value("LDLIBRARY")) if name and ".so" in name]
    libraries = [Path(folder) / name for name in names for folder in folders if folder]
    return {
        "python": sys.executable,
        "libpython": str(next((path for path in libraries if path.exists()), "")),
        "packages": str(Path(np.__file__).parents[1]),
    }


def compiled() -> bytes | None:
    """Return the front's binary, compiled once per process; None, with a warning, if that cannot be done."""
    return _compiled(os.environ.get("CC", ""))


@functools.cache
def _compiled(wish: str) -> bytes | None:
    compiler = shlex.split(wish) or [name for name in ("cc", "gcc", "clang") if shutil.which(name)][:1]
    if not compiler or not shutil.which(compiler[0]):
        missing = f"CC={wish}, which is not here" if wish else "neither CC, cc, gcc nor clang"
        _log.warning(_LOST, f"expected a C compiler, received {missing}")
        return None
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        target = Path(work, "front.so")
        sources = sorted(path.name for path in SOURCES.glob("*.c"))
        command = [*compiler, *_FLAGS, f"-ffile-prefix-map={SOURCES}=.", "-I", str(HEADERS), *sources]
        done = subprocess.run(
            [*command, "-o", str(target), "-ldl", "-lpthread", "-lm"],
            cwd=SOURCES,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
        if done.returncode != 0 or not target.exists():
            said = next((line for line in done.stderr.splitlines() if "error" in line), f"exit code {done.returncode}")
            _log.warning(_LOST, f"expected {compiler[0]} to compile it, received {said}")
            return None
        return target.read_bytes()
