"""Packing a system description and its FMUs into one .ssp file."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

from ndob_fmu.cosim.ssp.schema import NAMESPACES, ROOTS_BY_SUFFIX, SSD_NAME, parse
from ndob_fmu.errors import CouplingError, UsageError
from ndob_fmu.results import atomic_path

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time a zip entry can have


def build_ssp(
    folder: str | Path, fmu_dir: str | Path, out_dir: str | Path, *, parameter_set: str | None = None
) -> Path:
    """Pack ``folder`` (SystemStructure.ssd, .ssv, .ssm and .ssb files) with its FMUs: ``out_dir/<folder's name>.ssp``.

    parameter_set: a folder inside, whose files replace those beside it; its name goes to that of the package.

    The FMUs are those the .ssd names, taken from ``fmu_dir``. The same files give the same bytes. Raises UsageError if
    the folder has no .ssd or the package cannot be written, CouplingError if the .ssd does not follow SSP 1.0 or an FMU
    is missing.
    """
    folder, fmu_dir = Path(folder), Path(fmu_dir)
    description = folder / SSD_NAME
    if not description.is_file():
        raise UsageError.report(str(folder), expected=f"a folder with {SSD_NAME}", received="none there")
    name = folder.resolve().name
    files = _descriptions(folder)
    if parameter_set is not None:
        if parameter_set not in parameter_sets(folder):
            expected = f"one of {', '.join(parameter_sets(folder)) or 'none'}"
            raise UsageError.report(f"parameter set of {name}", expected=expected, received=repr(parameter_set))
        files |= _descriptions(folder / parameter_set)
        name = f"{name}_{parameter_set}"
    for source in _sources(description, files[SSD_NAME]):
        fmu = fmu_dir / Path(source).name
        if not fmu.is_file():
            raise CouplingError.report(
                str(description), expected=f"{fmu.name} in {fmu_dir}", received="no such file", likely="not built yet"
            )
        files[source] = fmu.read_bytes()
    return write_package(Path(out_dir) / f"{name}.ssp", files)


def parameter_sets(folder: str | Path) -> list[str]:
    """Return the names of the parameter sets that a system has besides the one in its own folder."""
    return sorted({path.parent.name for path in Path(folder).glob("*/*.ssv")})


def _descriptions(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in ROOTS_BY_SUFFIX}


def write_package(target: Path, files: Mapping[str, bytes]) -> Path:
    """Write these files as a package; the same ones give the same bytes. Raises UsageError if it cannot be written."""
    with atomic_path(target) as temporary, zipfile.ZipFile(temporary, "w") as package:
        for name, data in sorted(files.items()):
            package.writestr(_entry(name), data, zipfile.ZIP_DEFLATED)
    return target


def _sources(description: Path, data: bytes) -> list[str]:
    root = parse(str(description), data, "SystemStructureDescription")
    return [element.get("source", "") for element in root.iter(f"{{{NAMESPACES['ssd']}}}Component")]


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.create_system = 3  # Unix everywhere, else the bytes would tell the builder's system
    entry.external_attr = 0o644 << 16
    return entry
