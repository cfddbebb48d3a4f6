"""Packing a system description and its FMUs into one .ssp file."""

from __future__ import annotations

import zipfile
from pathlib import Path
from xml.etree import ElementTree

from ndob_fmu.cosim.ssd import SSD_NAME, local_name
from ndob_fmu.errors import CouplingError, UsageError
from ndob_fmu.results import atomic_path

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time a zip entry can have


def build_ssp(folder: str | Path, fmu_dir: str | Path, out_dir: str | Path) -> Path:
    """Pack ``folder`` (SystemStructure.ssd and its .ssv files) with its FMUs as ``out_dir/<folder's name>.ssp``.

    The FMUs are those the .ssd names, taken from ``fmu_dir``. The same files give the same bytes. Raises UsageError if
    the folder has no .ssd or the package cannot be written, CouplingError if the .ssd is no XML or an FMU is missing.
    """
    folder, fmu_dir = Path(folder), Path(fmu_dir)
    description = folder / SSD_NAME
    if not description.is_file():
        raise UsageError.report(str(folder), expected=f"a folder with {SSD_NAME}", received="none there")
    files = {SSD_NAME: description} | {path.name: path for path in folder.glob("*.ssv")}
    for source in _sources(description):
        fmu = fmu_dir / Path(source).name
        if not fmu.is_file():
            raise CouplingError.report(
                str(description), expected=f"{fmu.name} in {fmu_dir}", received="no such file", likely="not built yet"
            )
        files[source] = fmu
    target = Path(out_dir) / f"{folder.resolve().name}.ssp"
    with atomic_path(target) as temporary, zipfile.ZipFile(temporary, "w") as package:
        for name, path in sorted(files.items()):
            package.writestr(_entry(name), path.read_bytes(), zipfile.ZIP_DEFLATED)
    return target


def _sources(description: Path) -> list[str]:
    try:
        root = ElementTree.parse(description).getroot()
    except ElementTree.ParseError as error:
        raise CouplingError.report(str(description), expected="well-formed XML", received=str(error)) from error
    return [element.get("source", "") for element in root.iter() if local_name(element) == "Component"]


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.create_system = 3  # Unix everywhere, else the bytes would tell the builder's system
    entry.external_attr = 0o644 << 16
    return entry
