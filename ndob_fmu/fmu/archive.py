"""The file of an FMU: description, code, binaries and documentation in one archive, the same bytes for the same FMU."""

from __future__ import annotations

import hashlib
import uuid
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import pythonfmu

from ndob_fmu.fmu.bundle import Bundle
from ndob_fmu.fmu.compile_front import with_front
from ndob_fmu.fmu.fmi2_xml import model_description
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.support.files import atomic_path
from ndob_fmu.support.progress import begin

_FIXED_TIME = (1980, 1, 1, 0, 0, 0)
_PYTHONFMU = Path(pythonfmu.__file__).parent
_BINARIES = _PYTHONFMU / "resources" / "binaries"


def package(path: Path, fmu: FmuDescription, code: Bundle, documentation: Mapping[str, bytes]) -> Path:
    """Write the FMU `path` with this description, code and documentation (by path in the archive); return its path.

    Raises ModelError for an invalid unit, UsageError where the folder cannot be written.
    """
    begin(f"building {path.name}")
    root = model_description(fmu)
    contents = {
        **{f"resources/{name}": text.encode() for name, text in code.files.items()},
        **_pythonfmu_files(fmu.name),
        # pythonfmu's binary reads here which module it imports.
        "resources/slavemodule.txt": PurePosixPath(code.entry).stem.encode(),
    }
    root.set("guid", guid := _guid(root, contents))
    contents["modelDescription.xml"] = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    with atomic_path(path) as target:
        write_archive(target, with_front(contents, fmu, guid) | dict(documentation))
    return path


def _pythonfmu_files(name: str) -> dict[str, bytes]:
    """Return pythonfmu's Python files, and its binaries under the names that a host looks for."""
    modules = {f"resources/pythonfmu/{path.name}": path.read_bytes() for path in _PYTHONFMU.glob("*.py")}
    binaries = {
        f"binaries/{path.parent.name}/{name}{path.suffix}": path.read_bytes()
        for path in _BINARIES.glob("*/*")
        if path.suffix in (".so", ".dll", ".dylib")
    }
    return modules | binaries


def _guid(root: ET.Element, contents: Mapping[str, bytes]) -> str:
    """Return the identity of what the FMU computes: of its description and of the Python that it runs.

    Compiled binaries, the interpreter that the build recorded for them, the manual and the icon are left out: they
    differ from machine to machine, and a master that compares GUIDs would take the same model for another one.
    """
    whole = hashlib.sha256(ET.tostring(root))
    for name in sorted(contents):
        if name.startswith("resources/") and name.endswith(".py"):
            whole.update(f"\0{name}\0".encode() + contents[name])
    return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, whole.hexdigest())}}}"


def write_archive(path: Path, contents: Mapping[str, bytes]) -> None:
    """Write the archive `path` with these files, by their path in it."""
    with zipfile.ZipFile(path, "w") as packed:
        for name in sorted(contents):
            entry = zipfile.ZipInfo(name, _FIXED_TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system, entry.external_attr = 3, 0o100644 << 16  # as from Unix, wherever the build runs
            packed.writestr(entry, contents[name], compresslevel=9)
