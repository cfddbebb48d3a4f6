"""Reading a TOML file. A message about a mistake says where it is and what is allowed there."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ndob_fmu.errors import NdobError, UsageError, nearest, one_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


_MOST_BYTES = 16 * 2**20
_MOST_LEVELS = 20
_NESTING = f"tables and lists nested at most {_MOST_LEVELS} levels deep"
_NUMBERS = "whole numbers of at most 64 bits"


@dataclass(frozen=True)
class TomlTable:
    """One table of the file; ``where`` is how messages call it."""

    where: str
    entries: Mapping[str, Any]

    def only(self, known: Collection[str]) -> None:
        """Raise UsageError, naming the nearest one, for an entry that is not among ``known``."""
        for name in self.entries:
            if name not in known:
                raise UsageError.report(
                    self.where, expected=one_of("entry", known, name), received=repr(name), likely=nearest(name, known)
                )

    def get(self, name: str, kind: type | tuple[type, ...], default: Any, expected: str) -> Any:
        """Return an entry; raise UsageError if it is not of that kind; a default of ``...`` makes it required."""
        value = self.entries.get(name, default)
        if value is ...:
            raise UsageError.report(self.where, expected=f"{name} = {expected}", received="no such line")
        if value is not default and (not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool)):
            raise self.wrong(name, expected, value)
        return value

    def number(self, name: str, default: Any, expected: str = "a number") -> Any:
        """Return a number as a float."""
        value = self.get(name, (int, float), default, expected)
        if isinstance(value, float) and not math.isfinite(value):
            raise self.wrong(name, f"{expected} that is finite", value)
        return float(value) if isinstance(value, int) else value

    def count(self, name: str, default: Any, least: int, most: int) -> int:
        """Return a whole number between two bounds."""
        expected = f"a whole number from {least} to {most}"
        value: int = self.get(name, int, default, expected)
        if not least <= value <= most:
            raise self.wrong(name, expected, value)
        return value

    def path(self, name: str, default: Any, expected: str) -> str | None:
        """Return the path of a file; raise UsageError for characters that no path has."""
        value: str | None = self.get(name, str, default, expected)
        if value is not None and not value.isprintable():
            raise self.wrong(name, f"{expected} without control characters", value)
        return value

    def names(self, name: str, default: Any, expected: str) -> Any:
        """Return a list of different names, or the default."""
        value = self.get(name, list, default, expected)
        if value is default:
            return value
        if not all(isinstance(entry, str) for entry in value) or len(set(value)) < len(value):
            raise self.wrong(name, f"{expected}, each once", value)
        return value

    def section(self, name: str) -> TomlTable:
        """Return a table, empty if the file has none of that name."""
        return TomlTable(f"{self.where}, [{name}]", self.get(name, dict, {}, f"a table [{name}]"))

    def wrong(self, name: str, expected: str, received: Any, likely: str = "") -> NdobError:
        """Return the error for an entry that cannot be used."""
        return UsageError.report(f"{self.where}, {name}", expected=expected, received=repr(received), likely=likely)


def read_toml(path: Path) -> TomlTable:
    """Return the whole file; raise UsageError if it cannot be read or is not TOML, with the line and what is there.

    Numbers fit into 64 bits, tables and lists are nested at most some levels deep.
    """
    where = str(path)
    try:
        with path.open("rb") as file:
            data = file.read(_MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        raise UsageError.report(where, expected="a study file that can be read", received=str(error)) from error
    if len(data) > _MOST_BYTES:
        raise UsageError.report(where, expected=f"a study file of at most {_MOST_BYTES // 2**20} MiB", received="more")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise UsageError.report(where, expected="text in UTF-8", received=str(error)) from error
    try:
        entries = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError.report(
            where, expected="TOML", received=str(error), likely="text needs quotes, a list needs [ and ]"
        ) from error
    except ValueError as error:  # Python's own limit for the digits of a number
        raise UsageError.report(where, expected=_NUMBERS, received="a number of thousands of digits") from error
    except RecursionError as error:
        raise UsageError.report(where, expected=_NESTING, received="many more") from error
    _check_values(where, entries)
    return TomlTable(where, entries)


def _check_values(where: str, entries: Any) -> None:
    level = [entries]
    for _ in range(_MOST_LEVELS):
        inside = [value for part in level for value in (part.values() if isinstance(part, dict) else part)]
        large = [value for value in inside if isinstance(value, int) and not -(2**63) <= value < 2**63]
        if large:
            raise UsageError.report(where, expected=_NUMBERS, received=f"one of {large[0].bit_length()} bits")
        level = [value for value in inside if isinstance(value, dict | list)]
        if not level:
            return
    raise UsageError.report(where, expected=_NESTING, received="more")
