"""Names of the files in a package.

Some tools unpack the files of a package into one folder, by file name, so that no two may have the same name.
"""

from __future__ import annotations

import re

_LONGEST = 100  # characters of a name without its ending; file systems take 255 bytes, some tools 260 for a whole path
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)", re.IGNORECASE)  # devices of Windows


def plain(name: str) -> str:
    """Return the name with ``_`` for all but ASCII letters, digits, ``_`` and ``-``, which every file system takes."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)


class FileNames:
    """Gives out file names of which no two are equal, also where a file system ignores the case of letters."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def new(self, stem: str, suffix: str) -> str:
        """Return a name made of ``stem`` in plain characters; a number follows it where the name is taken."""
        stem = plain(stem)[:_LONGEST]
        if _RESERVED.fullmatch(stem):
            stem = f"{stem}_"
        name, number = f"{stem}{suffix}", 1
        while name.lower() in self._taken:
            number += 1
            name = f"{stem}_{number}{suffix}"
        self._taken.add(name.lower())
        return name
