"""One record for each component FMU: all that the build, the pages and the tests know of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ndob_fmu.fmu.archive import package
from ndob_fmu.fmu.bundle import bundle
from ndob_fmu.fmu.documentation_files import documentation_files
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.fmu.icon import Icon, draw_icon
from ndob_fmu.fmu.manual import page
from ndob_fmu.interface.variables import Variable
from ndob_fmu.runtime.equations import Experiment

_EXPERIMENT = Experiment(stop_time=10.0, step_size=1e-3)


@dataclass(frozen=True)
class ComponentRecord:
    """A component FMU.

    name: of the FMU; its slave is the class `<Name>Slave` in fmus/<name>_slave.py
    text: what it is, in one line
    variables: all variables; the slave gets them as its argument
    page: what its page says, in Jinja, with {{ variables }} where their tables go
    icon: its picture
    experiment: the default experiment
    """

    name: str
    text: str
    variables: tuple[Variable, ...]
    page: str
    icon: Icon
    experiment: Experiment = _EXPERIMENT

    def build(self, out: str | Path) -> Path:
        """Write `<Name>.fmu` into the folder `out` and return its path.

        Raises UsageError where the folder cannot be written.
        """
        return write_component(self, self.name, _data(self.variables), ("VARIABLES",), out)


def write_component(record: ComponentRecord, slave: str, data: str, arguments: Sequence[str], out: str | Path) -> Path:
    """Write the FMU of a record into the folder `out` and return its path.

    slave: the slave is the class `<slave>Slave` in fmus/<slave>_slave.py
    data: text of a Python module that defines the arguments of the slave
    arguments: their names

    Raises UsageError where the folder cannot be written.
    """
    module = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", slave).lower()
    return package(
        Path(out, f"{record.name}.fmu"),
        FmuDescription(record.name, record.text, record.variables, record.experiment),
        bundle(record.name, f"{module}_slave", f"{slave}Slave", data, arguments),
        documentation_files(page(record.name, record.text, record.page, record.variables), draw_icon(record.icon)),
    )


def _data(variables: Sequence[Variable]) -> str:
    listed = "".join(f"    {variable!r},\n" for variable in variables)
    return f"from {Variable.__module__} import Enumeration, Variable\n\nVARIABLES = (\n{listed})\n"
