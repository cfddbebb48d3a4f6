"""Reading a packaged system description (.ssp, SSP 1.0) as a System.

fmpy's schemas check the files. Neither fmpy.ssp nor pyssp-standard reads them: the one passes over transformations,
units, mappings inside a description and parameters' units, the other over transformations and nested systems.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote, urlsplit

from ndob_fmu.cosim.default_experiment import DefaultExperiment
from ndob_fmu.cosim.fmi.fmu_component import FmuComponent
from ndob_fmu.cosim.fmi.zip_archive import Archive, open_archive
from ndob_fmu.cosim.ssp.parameters import start_values
from ndob_fmu.cosim.ssp.read_structure import read_structure
from ndob_fmu.cosim.ssp.scaling import Units, read_units
from ndob_fmu.cosim.ssp.schema import NAMESPACES, ROOTS_BY_SUFFIX, SSD_NAME, Element, child, local_name, parse
from ndob_fmu.cosim.ssp.structure import Structure, components
from ndob_fmu.cosim.ssp.supported import check_supported
from ndob_fmu.cosim.ssp.timing import read_experiment, read_step_ratios
from ndob_fmu.cosim.system.ports import Port
from ndob_fmu.cosim.system.system import System
from ndob_fmu.errors import CouplingError, NdobError, some_of
from ndob_fmu.support.temporary import temporary_folder


@contextmanager
def open_ssp(path: str | Path, step_size: float | None = None) -> Iterator[tuple[System, DefaultExperiment]]:
    """Give the system in the package and its default experiment; its FMUs are in a temporary folder until the end.

    step_size: the communication step (s), by default that of the experiment, of which the components' own steps are
    multiples. Components of nested systems are named ``system.component``.

    Raises UsageError if there is no such file, CouplingError if it is damaged, is incomplete, contradicts itself or
    uses a part of SSP that would not be honoured.
    """
    path = Path(path)
    with temporary_folder() as folder, open_archive(path) as archive:
        package = Package(path, archive)
        root = package.description()
        experiment = read_experiment(package.where, root)
        unused = package.check_files(root)
        parts = read_components(package, root, archive, folder)
        system = read_system(package, root, parts, experiment.step_size if step_size is None else step_size)
        yield replace(system, warnings=(*unused, *system.warnings)), experiment


class Package:
    """The files in an opened package, each parsed, checked against its schema and for what is not supported."""

    def __init__(self, path: Path, archive: Archive) -> None:
        self.path = path
        self.where = f"{path}, {SSD_NAME}"
        self._archive = archive
        self._parsed: dict[str, Element] = {}

    def description(self) -> Element:
        """Return the root of the package's SystemStructure.ssd."""
        if SSD_NAME not in self._archive.namelist():
            raise CouplingError.report(str(self.path), expected=f"a package with {SSD_NAME}", received="one without it")
        return self.file(SSD_NAME, "SystemStructureDescription")

    def file(self, entry: str, root_name: str) -> Element:
        """Return the root of one file of the package."""
        if entry not in self._parsed:
            where = f"{self.path}, {entry}"
            root = parse(where, self._archive.read_xml(entry), root_name)
            check_supported(where, root)
            self._parsed[entry] = root
        return self._parsed[entry]

    def source(self, element: Element) -> Element:
        """Return the root of what a binding, a mapping or a signal dictionary names as its source, or has inside."""
        kind = local_name(element)
        root_name = {"ParameterBinding": "ParameterSet"}.get(kind, kind)
        uri = element.get("source")
        if uri is not None:
            return self.file(self.entry(f"source of a {kind}", uri), root_name)
        inside = [part for part in element.iter("*") if local_name(part) == root_name and part is not element]
        if not inside:
            raise CouplingError.report(
                f"{self.where}, {kind}", expected=f"a source or a {root_name}", received="neither"
            )
        return inside[0]

    def check_files(self, root: Element) -> list[str]:
        """Check the files that the description names; return a warning where others, as variants, could not be used.

        Raises CouplingError for a file that the description names and that cannot be used.
        """
        for kind in ("ParameterBinding", "ParameterMapping", "SignalDictionary"):
            for element in root.iter(f"{{{NAMESPACES['ssd']}}}{kind}"):
                self.source(element)
        faults: dict[str, str] = {}
        for name in self._archive.namelist():
            if Path(name).suffix in ROOTS_BY_SUFFIX and name not in self._parsed:
                try:
                    self.file(name, ROOTS_BY_SUFFIX[Path(name).suffix])
                except CouplingError as error:
                    faults[name] = str(error).removeprefix(f"{self.path}, {name}: ")
        if not faults:
            return []
        return [f"{some_of(faults)} could not be used, but {SSD_NAME} does not name it: {next(iter(faults.values()))}"]

    def entry(self, where: str, uri: str) -> str:
        """Return the name of the package's file that a URI means, which is relative to the description."""
        parts = urlsplit(uri)
        name = unquote(parts.path).removeprefix("./")
        if parts.scheme or parts.netloc or name.startswith("/") or ".." in name.split("/"):
            raise CouplingError.report(f"{self.path}, {where}", expected="a file in the package", received=repr(uri))
        if name not in self._archive.namelist():
            suffix = Path(name).suffix
            there = [other for other in self._archive.namelist() if other.endswith(suffix)]
            raise CouplingError.report(
                f"{self.path}, {where}",
                expected=f"{name} in the package",
                received=some_of(there) if there else f"no {suffix} file",
            )
        return name


def read_components(package: Package, root: Element, archive: Archive, folder: Path) -> dict[str, FmuComponent]:
    """Unpack the FMUs of a description, each once, into a folder and return its components by their full names."""
    fmus: dict[str, Path] = {}
    parts: dict[str, FmuComponent] = {}
    for name, element in components(child(root, "ssd:System")):
        entry = package.entry(f"component {name}", element.get("source"))
        if entry not in fmus:
            fmus[entry] = archive.extract(entry, folder)
        if name in parts:
            raise CouplingError.report(
                f"{package.path}, component {name}", expected="a new name", received="one that is taken"
            )
        try:
            parts[name] = FmuComponent(fmus[entry], name)
        except NdobError as error:  # which names the file where it lies now, and not in the package
            raise type(error)(str(error).replace(str(fmus[entry]), f"{package.path}, {entry}")) from error
    return parts


def read_system(package: Package, root: Element, parts: dict[str, FmuComponent], step_size: float | None) -> System:
    """Return the system of a description whose components are these."""
    top = child(root, "ssd:System")
    bare = System(parts, step_ratios=read_step_ratios(package.where, top, step_size))

    def dictionary(element: Element) -> tuple[Element, Units]:
        found = package.source(element)
        return found, read_units(found if element.get("source") else root)

    structure = read_structure(package.where, top, bare.variable, read_units(root), dictionary)
    _check_connectors(structure, bare)
    starts, mapped = start_values(bare, structure, top, package.source)
    inputs = structure.inputs()
    behind = {link.port for links in inputs.values() for link in links}
    inputs |= {
        name: links
        for name, links in mapped.items()
        if name not in inputs and behind.isdisjoint(link.port for link in links)
    }
    undriven = structure.undriven_outputs()
    return replace(
        bare,
        connections=structure.connections(),
        start_values=starts,
        inputs=inputs,
        outputs=structure.outputs(),
        warnings=(f"nothing drives {some_of(undriven)} at the boundary; no row has a value",) if undriven else (),
    )


def _check_connectors(structure: Structure, system: System) -> None:
    for node, declared in structure.signals.items():
        if node.owner not in structure.parts:
            continue
        variable = system.variable(Port(*node))
        for attribute, actual, said in (
            ("causality", variable.causality, declared.kind),
            ("type", variable.type, declared.type),
            ("unit", variable.unit, declared.unit.name),
        ):
            if actual and said and actual != said:
                raise CouplingError.report(
                    f"{structure.where}, connector {node}",
                    expected=f"the {attribute} {actual} of the FMU",
                    received=said,
                    likely="the FMU was changed after the description was written",
                )
