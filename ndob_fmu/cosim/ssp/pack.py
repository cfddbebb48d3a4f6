"""Packing a system description and its FMUs into one .ssp file."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote

from ndob_fmu.cosim.component import Value
from ndob_fmu.cosim.fmi.archive import open_archive
from ndob_fmu.cosim.fmi.start_values import with_start_values
from ndob_fmu.cosim.ssp.default_experiment import read_experiment
from ndob_fmu.cosim.ssp.identifiers import plain
from ndob_fmu.cosim.ssp.read import Package, read_components, read_system
from ndob_fmu.cosim.ssp.schema import ROOTS_BY_SUFFIX, SSD_NAME, Element, child, parse
from ndob_fmu.cosim.ssp.structure import components
from ndob_fmu.errors import CouplingError, UsageError, one_of
from ndob_fmu.support.files import atomic_path
from ndob_fmu.support.temporary import temporary_folder

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time a zip entry can have


def build_ssp(
    folder: str | Path, fmu_dir: str | Path, out_dir: str | Path, *, parameter_set: str | None = None
) -> Path:
    """Pack ``folder`` (SystemStructure.ssd, .ssv, .ssm and .ssb files) with its FMUs: ``out_dir/<folder's name>.ssp``.

    parameter_set: a folder inside, whose files replace those beside it; its name goes to that of the package.

    The FMUs are those the .ssd names, taken from ``fmu_dir``: ``resources/plant_Arm.fmu`` of the component ``plant`` is
    Arm.fmu there, unless there is a plant_Arm.fmu. FMUs that were built by this package get the start values of the
    system, for tools that do not read them. The same files give the same bytes. Raises UsageError if the folder has no
    .ssd or the package cannot be written, CouplingError if an FMU is missing or the system cannot be run.
    """
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
    return write_package(Path(out_dir) / f"{name}.ssp", files)


def parameter_sets(folder: str | Path) -> list[str]:
    """Return the names of the parameter sets that a system has besides the one in its own folder."""
    return sorted({path.parent.name for path in Path(folder).glob("*/*.ssv")})


def _descriptions(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in ROOTS_BY_SUFFIX}


def write_package(target: Path, files: Mapping[str, bytes]) -> Path:
    """Write these files as a package, with the start values of the system also in its FMUs.

    The same files give the same bytes. Raises UsageError if it cannot be written, CouplingError if it could not be run.
    """
    with atomic_path(target) as temporary:
        _zip(temporary, files)
        _zip(temporary, {**files, **_started(target, temporary)})
    return target


def _started(target: Path, written: Path) -> dict[str, bytes]:
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
            source: with_start_values(parts[name].path, dict(sorted(values[source].items())))
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
