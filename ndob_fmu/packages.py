"""Systems as packages (.ssp) whose FMUs start with the system's values, as far as this package has built them.

For tools that set no Enumerations or read no parameter sets: `cosim` writes a package of any FMUs, `fmu` knows how our
own take other start values, and only here the two meet.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from io import BytesIO
from pathlib import Path

from ndob_fmu.cosim.component import Value, Variable
from ndob_fmu.cosim.default_experiment import DefaultExperiment
from ndob_fmu.cosim.fmi.model_description import read_description
from ndob_fmu.cosim.fmi.zip_archive import open_archive
from ndob_fmu.cosim.ssp.pack import pack_folder
from ndob_fmu.cosim.ssp.write import write_system
from ndob_fmu.cosim.system.system import System
from ndob_fmu.cosim.values import convert
from ndob_fmu.errors import CouplingError
from ndob_fmu.fmu import start_values as of_python
from ndob_fmu.native import start_values as of_native


def build_ssp(
    folder: str | Path, fmu_dir: str | Path, out_dir: str | Path, *, parameter_set: str | None = None
) -> Path:
    """Pack ``folder`` (SystemStructure.ssd, .ssv, .ssm and .ssb files) with its FMUs: ``out_dir/<folder's name>.ssp``.

    parameter_set: a folder inside, whose files replace those beside it; its name is added to that of the package.

    The .ssd names the FMUs, which are taken from ``fmu_dir``: ``resources/plant_Arm.fmu`` of the component ``plant`` is
    Arm.fmu there, unless there is a plant_Arm.fmu. The same files give the same bytes. Raises UsageError if the folder
    has no .ssd or the package cannot be written, CouplingError if an FMU is missing or the system cannot be run.
    """
    return pack_folder(folder, fmu_dir, out_dir, parameter_set=parameter_set, restart=fmu_with_start_values)


def write_ssp(
    system: System,
    path: str | Path,
    *,
    start_time: float = 0.0,
    stop_time: float | None = None,
    step_size: float | None = None,
    parameter_set: str = "nominal",
    description: str = "",
) -> Path:
    """Write a system with its FMUs as a package (.ssp) and return its path; the same system gives the same bytes.

    start_time, stop_time, step_size: the default experiment, in s.
    parameter_set: the name of all start values.
    description: what the package says of itself.

    Names at the boundary become connectors, and those of parameters the entries of a parameter mapping; a package
    without any keeps to what libcosim, ecos, OMSimulator and fmpy read. An input that nothing drives goes with the
    start value of its FMU, and a warning is logged.

    Raises CouplingError for a component that is not an FMU, and start values that contradict a name at the boundary;
    UsageError for step ratios without step_size and a file that cannot be written.
    """
    experiment = DefaultExperiment(start_time, stop_time, step_size)
    return write_system(system, Path(path), experiment, parameter_set, description, restart=fmu_with_start_values)


def fmu_with_start_values(fmu: str | Path, values: Mapping[str, Value]) -> bytes:
    """Return the FMU file with these start values of inputs and parameters in its model description and its code.

    An FMU that was not built by this package is returned unchanged: its code has its own start values. Raises
    UsageError if there is no such file or for a value that a variable cannot take, CouplingError for a name that is
    not one of its inputs and parameters, and if the file is not an FMU.
    """
    path = Path(fmu)
    with open_archive(path):  # which says why, where it is no such file
        content = hashlib.sha256(path.read_bytes()).digest()
    return _restarted(_Wanted(content, repr(dict(values)), path, values))


@dataclass(frozen=True)
class _Wanted:
    """An FMU by its content, and start values by their text, in which 0.0 and -0.0 are not equal."""

    content: bytes
    text: str
    path: Path = field(compare=False)
    values: Mapping[str, Value] = field(compare=False)


@lru_cache(maxsize=32)  # systems of one model have most of their FMUs in common
def _restarted(wanted: _Wanted) -> bytes:
    path, values = wanted.path, wanted.values
    variables = {variable.name: variable for variable in read_description(path).variables}
    with open_archive(path) as archive:
        contents = {entry: archive.read(entry.filename) for entry in archive.infolist()}
    files = {entry.filename: data for entry, data in contents.items()}
    build = next((one for one in (of_python, of_native) if one.takes_start_values(files)), None)
    if build is None or not values:
        return path.read_bytes()
    starts = {name: _start(path, variables, name, value) for name, value in values.items()}
    files = build.restarted(files, starts)
    packed = BytesIO()
    with zipfile.ZipFile(packed, "w") as target:
        for entry in contents:
            target.writestr(entry, files[entry.filename], zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _start(path: Path, variables: Mapping[str, Variable], name: str, value: Value) -> Value:
    variable = variables.get(name)
    if variable is None or not variable.settable:
        received = "none" if variable is None else f"one of causality {variable.causality}"
        raise CouplingError.report(f"{path}, {name}", expected="a variable that takes a start value", received=received)
    return convert(variable, value, f"{path}, {name}")
