"""Build `<Name>Plant.fmu` and `<Name>Observer.fmu` from a model."""

from __future__ import annotations

import hashlib
import os
import sys
import uuid
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pythonfmu.builder import FmuBuilder

from ndob_fmu.analysis.assumptions import check
from ndob_fmu.codegen.emit import emit_python
from ndob_fmu.fmu.archive_files import extras
from ndob_fmu.fmu.bundle import Bundle, bundle
from ndob_fmu.fmu.compile_front import with_front
from ndob_fmu.fmu.manual import Part
from ndob_fmu.fmu.model_description import complete
from ndob_fmu.interface.model_variables import Variable, observer_variables, plant_variables
from ndob_fmu.model.model import Model
from ndob_fmu.results.recordings import atomic_path
from ndob_fmu.support.progress import begin
from ndob_fmu.support.temporary import temporary_folder

_FIXED_TIME = (1980, 1, 1, 0, 0, 0)


def build(model: Model, out: str | Path = "build/fmus") -> tuple[Path, Path]:
    """Write `<Name>Plant.fmu` and `<Name>Observer.fmu` into the folder `out` and return their paths.

    Raises AssumptionError where the observer's assumptions fail at the model's default parameters, and UsageError
    where the folder cannot be written. A file that exists is replaced only by a whole new one.
    """
    check(model).require()
    folder = Path(out)
    text = emit_python(model)
    return (
        _build(model, "Plant", plant_variables(model.equations), text, folder),
        _build(model, "Observer", observer_variables(model.equations), text, folder),
    )


def _build(model: Model, part: Part, variables: tuple[Variable, ...], equations_text: str, folder: Path) -> Path:
    name = f"{model.name}{part}"
    content = bundle(name, f"{part.lower()}_slave", f"{part}Slave", equations_text, ("EQUATIONS",))
    return package(folder / f"{name}.fmu", content, variables, extras(model, part, variables))


def package(path: Path, content: Bundle, variables: tuple[Variable, ...], added: Mapping[str, bytes]) -> Path:
    """Write the FMU `path` of this code, with these variables and added files, and return its path.

    Raises ModelError for a unit that is none, UsageError where the folder cannot be written.
    """
    begin(f"building {path.name}")
    with temporary_folder() as work, _imports_undone(str(work)):
        source = Path(work, "source")
        for relative, text in content.files.items():
            inside = source / relative
            inside.parent.mkdir(parents=True, exist_ok=True)
            inside.write_text(text, "utf-8")
        carried = {source / Path(relative).parts[0] for relative in content.files if relative != content.entry}
        with _no_source_date():
            stock = FmuBuilder.build_FMU(source / content.entry, dest=work, project_files=sorted(carried))
        with atomic_path(path) as target:
            _repack(stock, target, variables, added)
    return path


@contextmanager
def _no_source_date() -> Iterator[None]:
    """Hide SOURCE_DATE_EPOCH: from Python 3.14 on zipfile takes it for pythonfmu's archive and fails before 1980."""
    before = os.environ.pop("SOURCE_DATE_EPOCH", None)
    try:
        yield
    finally:
        if before is not None:
            os.environ["SOURCE_DATE_EPOCH"] = before


def _repack(stock: Path, target: Path, variables: tuple[Variable, ...], added: Mapping[str, bytes]) -> None:
    """Copy the archive with its description completed and files added, in a fixed order and with fixed times."""
    with zipfile.ZipFile(stock) as source, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed:
        contents = {name: source.read(name) for name in source.namelist()}
        root = complete(ET.fromstring(contents["modelDescription.xml"]), variables)
        root.set("guid", _guid(root, contents))
        contents["modelDescription.xml"] = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
        contents = with_front(contents, root) | dict(added)
        for name in sorted(contents):
            entry = zipfile.ZipInfo(name, _FIXED_TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system, entry.external_attr = 3, 0o100644 << 16  # as from Unix, wherever the build runs
            packed.writestr(entry, contents[name])


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


@contextmanager
def _imports_undone(folder: str) -> Iterator[None]:
    """Undo what pythonfmu's builder leaves in this process: its entry on the path, and modules of files soon gone."""
    path = list(sys.path)
    try:
        yield
    finally:
        sys.path[:] = path
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", None)).startswith(folder):
                del sys.modules[name]
