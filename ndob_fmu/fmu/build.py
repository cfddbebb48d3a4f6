"""Build `<Name>Plant.fmu` and `<Name>Observer.fmu` from a model."""

from __future__ import annotations

import hashlib
import sys
import tempfile
import uuid
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pythonfmu.builder import FmuBuilder

from ndob_fmu.assumptions import check
from ndob_fmu.emit import emit_python
from ndob_fmu.fmu.bundle import bundle
from ndob_fmu.fmu.description import complete
from ndob_fmu.model import Model
from ndob_fmu.results import atomic_path
from ndob_fmu.runtime.interface import Variable, observer_variables, plant_variables

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
        _build(f"{model.name}Plant", "plant_slave", "PlantSlave", text, plant_variables(model.equations), folder),
        _build(
            f"{model.name}Observer",
            "observer_slave",
            "ObserverSlave",
            text,
            observer_variables(model.equations),
            folder,
        ),
    )


def _build(
    name: str, slave_module: str, slave_class: str, equations_text: str, variables: tuple[Variable, ...], folder: Path
) -> Path:
    content = bundle(name, slave_module, slave_class, equations_text)
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work, _imports_undone(work):
        source = Path(work, "source")
        for relative, text in content.files.items():
            path = source / relative
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
        carried = {source / Path(relative).parts[0] for relative in content.files if relative != content.entry}
        stock = FmuBuilder.build_FMU(source / content.entry, dest=work, project_files=sorted(carried))
        with atomic_path(folder / f"{name}.fmu") as target:
            _repack(stock, target, variables)
    return folder / f"{name}.fmu"


def _repack(stock: Path, target: Path, variables: tuple[Variable, ...]) -> None:
    """Copy the archive with its description completed, in a fixed order, with fixed times, compressed."""
    with zipfile.ZipFile(stock) as source, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed:
        contents = {name: source.read(name) for name in sorted(source.namelist())}
        root = ET.fromstring(contents["modelDescription.xml"])
        root.attrib.pop("generationDateAndTime", None)
        root.set("guid", "")
        identity = hashlib.sha256(ET.tostring(root))
        for name, data in contents.items():
            if name != "modelDescription.xml":
                identity.update(data)
        complete(root, variables, guid=f"{{{uuid.uuid5(uuid.NAMESPACE_OID, identity.hexdigest())}}}")
        contents["modelDescription.xml"] = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
        for name, data in contents.items():
            entry = zipfile.ZipInfo(name, _FIXED_TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            packed.writestr(entry, data)


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
