"""The files of a built FMU with other start values than it was built with."""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Iterable, Mapping
from xml.etree import ElementTree

from ndob_fmu.fmu.bundle import START_VALUES
from ndob_fmu.fmu.compile_front import DESCRIPTION as FRONT

_START_VALUES = f"resources/{START_VALUES}"
_DESCRIPTION = "modelDescription.xml"


def takes_start_values(names: Iterable[str]) -> bool:
    """Return whether an FMU with files of these names was built by this package, so that its code reads new values."""
    return _START_VALUES in names


def restarted(files: Mapping[str, bytes], values: Mapping[str, float | int | bool | str]) -> dict[str, bytes]:
    """Return the files of an FMU, by name, with start values of its inputs and parameters in description and code.

    values: each in the type of its variable. The result is another FMU and has another GUID; the same values give the
    same bytes.
    """
    found = dict(files)
    starts = json.loads(found[_START_VALUES]) | dict(values)
    found[_START_VALUES] = (json.dumps(starts, sort_keys=True, indent=1) + "\n").encode()
    root = ElementTree.fromstring(found[_DESCRIPTION])
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, root.get('guid', '') + json.dumps(starts, sort_keys=True))}}}"
    root.set("guid", guid)
    for scalar in root.iterfind("ModelVariables/ScalarVariable"):
        if scalar.get("name") in starts:
            scalar[0].set("start", _text(starts[scalar.get("name", "")]))
    found[_DESCRIPTION] = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    if FRONT in found:
        found[FRONT] = re.sub(rb"(?m)^guid=.*$", f"guid={guid}".encode(), found[FRONT], count=1)
    return found


def _text(value: float | int | bool | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return value if isinstance(value, str) else repr(value)
