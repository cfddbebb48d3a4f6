"""The file of a native FMU: description, sources, binaries and documentation; the same bytes for the same FMU."""

from __future__ import annotations

import hashlib
import uuid
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from ndob_fmu.fmu import fmi2_xml, fmi3_xml
from ndob_fmu.fmu.archive import write_archive
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.native.compile import PLATFORMS, binary
from ndob_fmu.native.sources import ComponentCode, sources
from ndob_fmu.support.files import atomic_path
from ndob_fmu.support.progress import begin


def package(
    path: Path,
    fmu: FmuDescription,
    code: ComponentCode,
    documentation: Mapping[str, bytes],
    *,
    platforms: Sequence[str],
    fmi: int = 2,
    keep: bool = False,
) -> Path:
    """Write the native FMU `path` and return its path.

    documentation: files by their path in the archive
    platforms: names in PLATFORMS of the binaries that it carries
    fmi: FMI's version, 2 or 3
    keep: leave a file as it is that has all of this, and binaries for these platforms

    Raises ModelError for an invalid unit, UsageError where a binary cannot be compiled or the folder not be written.
    """
    begin(f"building {path.name}")
    listed = [f"{fmu.name}.c"]
    root = fmi2_xml.model_description(fmu, listed) if fmi == 2 else fmi3_xml.model_description(fmu)
    token = _token(root, sources(fmu.name, "", fmu.variables, code, fmi))
    root.set("guid" if fmi == 2 else "instantiationToken", token)
    files = sources(fmu.name, token, fmu.variables, code, fmi)
    contents = {f"sources/{name}": text.encode() for name, text in files.items()}
    contents["modelDescription.xml"] = _xml(root)
    if fmi == 3:
        contents["sources/buildDescription.xml"] = _xml(fmi3_xml.build_description(fmu, listed))
    libraries = {
        target: f"binaries/{PLATFORMS[target].folders[fmi - 2]}/{fmu.name}{PLATFORMS[target].suffix}"
        for target in platforms
    }
    if keep and _has(path, contents | dict(documentation), libraries.values()):
        return path
    for target, library in libraries.items():
        contents[library] = binary(fmu.name, files, target)
    with atomic_path(path) as temporary:
        write_archive(temporary, contents | dict(documentation))
    return path


def _has(path: Path, contents: Mapping[str, bytes], others: Iterable[str]) -> bool:
    """Return whether there is an archive with these contents and with the other files."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {*contents, *others} <= {*archive.namelist()} and all(
                archive.read(name) == data for name, data in contents.items()
            )
    except (OSError, zipfile.BadZipFile):
        return False


def _token(root: ET.Element, files: Mapping[str, str]) -> str:
    """Return the identity of what the FMU computes: of its description and of its sources."""
    whole = hashlib.sha256(ET.tostring(root))
    for name in sorted(files):
        whole.update(f"\0{name}\0".encode() + files[name].encode())
    return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, whole.hexdigest())}}}"


def _xml(root: ET.Element) -> bytes:
    text: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text
