"""Reading a TOML file whose every mistake is answered with where it is and what would do there."""

from __future__ import annotations

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


@dataclass(frozen=True)
class Section:
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
        return float(value) if isinstance(value, int) else value

    def section(self, name: str) -> Section:
        """Return a table, empty if the file has none of that name."""
        return Section(f"{self.where}, [{name}]", self.get(name, dict, {}, f"a table [{name}]"))

    def wrong(self, name: str, expected: str, received: Any, likely: str = "") -> NdobError:
        """Return the error for an entry that cannot be used."""
        return UsageError.report(f"{self.where}, {name}", expected=expected, received=repr(received), likely=likely)


def read_toml(path: Path) -> Section:
    """Return the whole file; raise UsageError if it cannot be read or is no TOML, with the line and what is there."""
    try:
        return Section(str(path), tomllib.loads(path.read_text("utf-8")))
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError.report(str(path), expected="a study file that can be read", received=str(error)) from error
    except tomllib.TOMLDecodeError as error:
        raise UsageError.report(
            str(path), expected="TOML", received=str(error), likely="text needs quotes, a list needs [ and ]"
        ) from error
