"""The files of a built FMU with other start values than it was built with."""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Mapping
from typing import TypeAlias
from xml.etree import ElementTree

from ndob_fmu.fmu.bundle import START_VALUES
from ndob_fmu.fmu.compile_front import DESCRIPTION as FRONT

Value: TypeAlias = float | int | bool | str
DESCRIPTION = "modelDescription.xml"
_START_VALUES = f"resources/{START_VALUES}"


def takes_start_values(files: Mapping[str, bytes]) -> bool:
    """Return whether these are the files of an FMU in Python of this package, whose code reads new values."""
    return _START_VALUES in files


def restarted(files: Mapping[str, bytes], values: Mapping[str, Value]) -> dict[str, bytes]:
    """Return the files of an FMU, by name, with start values of its inputs and parameters in description and code.

    values: each in the type of its variable. The result is another FMU and has another GUID; the same values give the
    same bytes.
    """
    found = dict(files)
    starts = json.loads(found[_START_VALUES]) | dict(values)
    found[_START_VALUES] = (json.dumps(starts, sort_keys=True, indent=1) + "\n").encode()
    found[DESCRIPTION], _, guid = described(found[DESCRIPTION], starts)
    if FRONT in found:
        found[FRONT] = re.sub(rb"(?m)^guid=.*$", f"guid={guid}".encode(), found[FRONT], count=1)
    return found


def described(description: bytes, starts: Mapping[str, Value]) -> tuple[bytes, str, str]:
    """Return a model description with these start values and another GUID, and its GUIDs before and now."""
    root = ElementTree.fromstring(description)
    before = root.get("guid", "")
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, before + json.dumps(starts, sort_keys=True))}}}"
    root.set("guid", guid)
    for scalar in root.iterfind("ModelVariables/ScalarVariable"):
        if scalar.get("name") in starts:
            scalar[0].set("start", _text(starts[scalar.get("name", "")]))
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True), before, guid


def _text(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return value if isinstance(value, str) else repr(value)
