"""Packing a system description and its FMUs into one .ssp file."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeAlias
from urllib.parse import unquote

from ndob_fmu.cosim.component import Value
from ndob_fmu.cosim.fmi.zip_archive import open_archive
from ndob_fmu.cosim.ssp.file_names import plain
from ndob_fmu.cosim.ssp.read_package import Package, read_components, read_system
from ndob_fmu.cosim.ssp.schema import ROOTS_BY_SUFFIX, SSD_NAME, Element, child, parse
from ndob_fmu.cosim.ssp.structure import components
from ndob_fmu.cosim.ssp.timing import read_experiment
from ndob_fmu.errors import CouplingError, UsageError, one_of
from ndob_fmu.support.files import atomic_path
from ndob_fmu.support.temporary import temporary_folder

# An FMU's file, start values of its variables → the file of the same FMU that starts with these values.
Restart: TypeAlias = Callable[[Path, Mapping[str, Value]], bytes]

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time a zip entry can have


def as_built(fmu: Path, values: Mapping[str, Value]) -> bytes:
    """Return an FMU's file unchanged; only the parameter sets of the package then have the start values."""
    return fmu.read_bytes()


def pack_folder(
    folder: str | Path,
    fmu_dir: str | Path,
    out_dir: str | Path,
    *,
    parameter_set: str | None = None,
    restart: Restart = as_built,
) -> Path:
    """Pack a folder with its FMUs; `ndob_fmu.packages.build_ssp` documents the other arguments and the errors."""
    folder, fmu_dir = Path(folder), Path(fmu_dir)
    description = folder / SSD_NAME
    if not description.is_file():
        raise UsageError.report(str(folder), expected=f"a folder with {SSD_NAME}", received="none there")
    name = folder.resolve().name
    files = _descriptions(folder)
    if parameter_set is not None:
        if parameter_set not in parameter_sets(folder):
            expected = one_of("parameter set", parameter_sets(folder), parameter_set)
            raise UsageError.report(f"parameter set of {name}", expected=expected, received=repr(parameter_set))
        files |= _descriptions(folder / parameter_set)
        name = f"{name}_{parameter_set}"
    for component, source in _sources(parse(str(description), files[SSD_NAME], "SystemStructureDescription")).items():
        fmu = fmu_dir / Path(source).name
        if not fmu.is_file():
            fmu = fmu_dir / fmu.name.removeprefix(f"{plain(component)}_")
        if not fmu.is_file():
            raise CouplingError.report(
                str(description), expected=f"{fmu.name} in {fmu_dir}", received="no such file", likely="not built yet"
            )
        files[source] = fmu.read_bytes()
    return write_package(Path(out_dir) / f"{name}.ssp", files, restart)


def parameter_sets(folder: str | Path) -> list[str]:
    """Return the names of the parameter sets that a system has besides the one in its own folder."""
    return sorted({path.parent.name for path in Path(folder).glob("*/*.ssv")})


def _descriptions(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in ROOTS_BY_SUFFIX}


def write_package(target: Path, files: Mapping[str, bytes], restart: Restart) -> Path:
    """Write these files as a package, whose FMUs ``restart`` gives the start values of the system.

    The same files give the same bytes. Raises UsageError if it cannot be written, CouplingError if it could not be run.
    """
    with atomic_path(target) as temporary:
        _zip(temporary, files)
        _zip(temporary, {**files, **_started(target, temporary, restart)})
    return target


def _started(target: Path, written: Path, restart: Restart) -> dict[str, bytes]:
    """Return the FMUs of a package with its start values; of several that use one FMU, those on which all agree."""
    with temporary_folder() as folder, open_archive(written) as archive:
        package = Package(target, archive)
        root = package.description()
        parts = read_components(package, root, archive, folder)
        system = read_system(package, root, parts, read_experiment(package.where, root).step_size)
        values: dict[str, dict[str, Value]] = {}
        for name, source in _sources(root).items():
            own = {port.variable: value for port, value in system.start_values.items() if port.component == name}
            values[source] = dict(values.get(source, own).items() & own.items())
        return {
            source: restart(parts[name].path, dict(sorted(values[source].items())))
            for name, source in _sources(root).items()
        }


def _zip(path: Path, files: Mapping[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as package:
        for name, data in sorted(files.items()):
            # An FMU is compressed already.
            package.writestr(_entry(name), data, zipfile.ZIP_STORED if name.endswith(".fmu") else zipfile.ZIP_DEFLATED)


def _sources(root: Element) -> dict[str, str]:
    """Return the FMU of each component by its name in the package."""
    found = components(child(root, "ssd:System"))
    return {name: unquote(element.get("source")).removeprefix("./") for name, element in found}


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.create_system = 3  # Unix everywhere, else the bytes would tell the builder's system
    entry.external_attr = 0o644 << 16
    return entry
