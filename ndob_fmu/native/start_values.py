"""The start values and the token of a native FMU: one block of data in its source and in each of its binaries.

So a packed system gives them other values without a compiler, and the FMU needs no file where it runs.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

from ndob_fmu.errors import UsageError
from ndob_fmu.fmu.start_values import DESCRIPTION, Value, described
from ndob_fmu.interface.variables import Variable
from ndob_fmu.native.mach_o import signed
from ndob_fmu.native.variable_table import number, quoted

_MARK = "ndob-fmu start values"
_MARK_SIZE, _TOKEN_SIZE, _TEXT_SIZE = 24, 40, 1024  # shell/fmu.h has the last two
_NUMBER = struct.Struct("<d")  # no platform of these FMUs has another order of bytes


def first_values(token: str, variables: Sequence[Variable]) -> str:
    """Return the C text that defines `first_values` (`shell/fmu.h`)."""
    texts = [variable for variable in variables if variable.type == "String"]
    numbers = "".join(
        "        0.0, /* a text */\n"
        if variable in texts
        else f"        {number(float(variable.start or 0.0))}, /* {variable.name} */\n"
        for variable in variables
    )
    written = "".join(f"        {quoted(str(variable.start or ''))}, /* {variable.name} */\n" for variable in texts)
    zero = "        {0},\n"  # C has no array without elements
    return (
        "static const volatile struct {\n"
        f"    char mark[{_MARK_SIZE}], token[TOKEN_SIZE];\n"
        f"    double numbers[{len(variables)}];\n"
        f"    char texts[{max(len(texts), 1)}][TEXT_SIZE];\n"
        "} first_values = {\n"
        f"    {quoted(_MARK)},\n"
        f"    {quoted(token)}, /* token */\n"
        f"    {{\n{numbers}    }},\n"
        f"    {{\n{written or zero}    }},\n"
        "};\n"
    )


def takes_start_values(files: Mapping[str, bytes]) -> bool:
    """Return whether these are the files of an FMU with a binary that has such a block."""
    return any(_is_binary(name) and _MARK.encode() in data for name, data in files.items())


def restarted(files: Mapping[str, bytes], values: Mapping[str, Value]) -> dict[str, bytes]:
    """Return the files of an FMU, by name, with start values in its description, its binaries and its source.

    values: each in the type of its variable. The result is another FMU and has another GUID; the same values give the
    same bytes.

    Raises UsageError for a text that is too long, and for a binary that was not built from the FMU's description.
    """
    description, old, new = described(files[DESCRIPTION], values)
    found = {**files, DESCRIPTION: description}
    places = _places(files[DESCRIPTION])
    for name, data in files.items():
        if _is_binary(name):
            found[name] = _in_binary(name, data, (old, new), places, values)
        elif name.startswith("sources/"):
            found[name] = _in_source(data.decode("utf-8"), (old, new), values).encode()
    return found


def _is_binary(name: str) -> bool:
    return name.startswith("binaries/") and name.endswith((".so", ".dll", ".dylib"))


def _places(description: bytes) -> dict[str, tuple[int, bool]]:
    """Return the place in the block of each variable's number, or of its text, and whether it is a text."""
    scalars = list(ElementTree.fromstring(description).iterfind("ModelVariables/ScalarVariable"))
    is_text = [scalar.find("String") is not None for scalar in scalars]
    texts = _MARK_SIZE + _TOKEN_SIZE + _NUMBER.size * len(scalars)
    return {
        scalar.get("name", ""): (texts + _TEXT_SIZE * sum(is_text[:i]), True)
        if is_text[i]
        else (_MARK_SIZE + _TOKEN_SIZE + _NUMBER.size * i, False)
        for i, scalar in enumerate(scalars)
    }


def _in_binary(
    name: str, data: bytes, tokens: tuple[str, str], places: Mapping[str, tuple[int, bool]], values: Mapping[str, Value]
) -> bytes:
    """Return the binary with the values; a universal one has a block for each processor."""
    head, new = (_MARK.encode().ljust(_MARK_SIZE, b"\0") + token.encode().ljust(_TOKEN_SIZE, b"\0") for token in tokens)
    changed, at = bytearray(data), data.find(head)
    if at < 0:
        raise UsageError.report(
            name,
            expected="the start values of its modelDescription.xml",
            received="none",
            likely="a binary of another FMU",
        )
    while at >= 0:
        changed[at : at + len(new)] = new
        for variable, value in values.items():
            place, is_text = places[variable]
            written = _text(variable, str(value)) if is_text else _NUMBER.pack(float(value))
            changed[at + place : at + place + len(written)] = written
        at = data.find(head, at + 1)
    return signed(bytes(changed))


def _text(name: str, value: str) -> bytes:
    written = value.encode()
    if len(written) >= _TEXT_SIZE:
        raise UsageError.report(name, expected="a text of fewer than 1024 bytes", received="a longer one")
    return written.ljust(_TEXT_SIZE, b"\0")


def _in_source(text: str, tokens: tuple[str, str], values: Mapping[str, Value]) -> str:
    """Return the source with the values; one without the block as it is."""
    begin, head, rest = text.partition("} first_values = {\n")
    block, end, after = rest.partition("\n};\n")
    block = block.replace(f"{quoted(tokens[0])}, /* token */", f"{quoted(tokens[1])}, /* token */")
    for name, value in values.items():
        written = quoted(value) if isinstance(value, str) else number(float(value))
        line = re.compile(rf"(?m)^ +.*, /\* {re.escape(name)} \*/$")
        block = line.sub(f"        {written}, /* {name} */".replace("\\", r"\\"), block)
    return begin + head + block + end + after
