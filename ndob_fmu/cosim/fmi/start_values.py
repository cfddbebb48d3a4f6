"""An FMU that starts with other values than it was built with: for tools that set no Enumerations or no parameters."""

from __future__ import annotations

import json
import re
import uuid
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree

from ndob_fmu.cosim.component import Value, Variable
from ndob_fmu.cosim.fmi.archive import open_archive
from ndob_fmu.cosim.fmi.description import read_description
from ndob_fmu.cosim.values import convert
from ndob_fmu.errors import CouplingError

# What fmus/slave_start_values.py reads, and what the front reads.
_START_VALUES = "resources/start_values.json"
_FRONT = "resources/front.txt"
_DESCRIPTION = "modelDescription.xml"


def with_start_values(fmu: str | Path, values: Mapping[str, Value]) -> bytes:
    """Return the FMU file with these start values of inputs and parameters in its model description and its code.

    An FMU that was not built by this package is returned as it is: its code has its own start values. One with other
    start values is another FMU and has another GUID. The same values give the same bytes. Raises UsageError if there is
    no such file or for a value that a variable cannot take, CouplingError for a name that is none of its inputs and
    parameters, and if the file is no FMU.
    """
    path = Path(fmu)
    variables = {variable.name: variable for variable in read_description(path).variables}
    with open_archive(path) as archive:
        if not values or _START_VALUES not in archive.namelist():
            return path.read_bytes()
        contents = {entry: archive.read(entry.filename) for entry in archive.infolist()}
    texts = {entry.filename: data for entry, data in contents.items()}
    starts = json.loads(texts[_START_VALUES]) | {name: _start(path, variables, name, values[name]) for name in values}
    texts[_START_VALUES] = (json.dumps(starts, sort_keys=True, indent=1) + "\n").encode()
    root = ElementTree.fromstring(texts[_DESCRIPTION])
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, root.get('guid', '') + json.dumps(starts, sort_keys=True))}}}"
    root.set("guid", guid)
    for scalar in root.iterfind("ModelVariables/ScalarVariable"):
        if scalar.get("name") in starts:
            scalar[0].set("start", _text(starts[scalar.get("name", "")]))
    texts[_DESCRIPTION] = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    if _FRONT in texts:
        texts[_FRONT] = re.sub(rb"(?m)^guid=.*$", f"guid={guid}".encode(), texts[_FRONT], count=1)
    packed = BytesIO()
    with zipfile.ZipFile(packed, "w") as target:
        for entry in contents:
            target.writestr(entry, texts[entry.filename], zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _start(path: Path, variables: Mapping[str, Variable], name: str, value: Value) -> Value:
    variable = variables.get(name)
    if variable is None or not variable.settable:
        received = "none" if variable is None else f"one of causality {variable.causality}"
        raise CouplingError.report(f"{path}, {name}", expected="a variable that takes a start value", received=received)
    return convert(variable, value, f"{path}, {name}")


def _text(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return value if isinstance(value, str) else repr(value)
