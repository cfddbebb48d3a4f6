"""Opening .fmu and .ssp files, which are zip archives, without trusting what they hold."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from ndob_fmu.errors import CouplingError, UsageError


@contextmanager
def open_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open a zip archive for reading.

    Raises UsageError if there is no such file, CouplingError if it is no zip archive, is damaged, or has an entry that
    would be unpacked outside its folder.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                if name.startswith("/") or ":" in name or "\\" in name or ".." in PurePosixPath(name).parts:
                    raise CouplingError.report(
                        str(path), expected="entries that stay inside the archive's folder", received=repr(name)
                    )
            yield archive
    except zipfile.BadZipFile as error:
        raise CouplingError.report(str(path), expected="a zip archive", received=str(error)) from error
    except OSError as error:
        raise UsageError.report(str(path), expected="a file that can be read", received=str(error)) from error
