"""Files and folders that are written whole or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ndob_fmu.errors import UsageError
from ndob_fmu.support.interrupts import held

# Only writing ends with these.
_NO_ROOM = (errno.ENOSPC, errno.EFBIG, errno.EROFS, getattr(errno, "EDQUOT", errno.ENOSPC))


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path to write to; it becomes ``path`` if the block succeeds, and vanishes if it fails.

    The temporary file lies in the same folder, which is made if missing, because only a rename within one file system
    is atomic; its ending is that of ``path``, because writers such as matplotlib take the format from it.
    Raises UsageError if the place cannot be written; an OSError of the block that is about another file stays as it is.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.stem}-{uuid.uuid4().hex[:12]}{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(target)
    except OSError as error:
        if not _is_about(error, target, temporary):
            raise
        raise UsageError.report(str(target), expected="a file that can be written", received=str(error)) from error
    finally:
        with held(), suppress(OSError):  # where nothing could be written there is nothing to remove either
            temporary.unlink()


@contextmanager
def atomic_folder(folder: str | Path) -> Iterator[Path]:
    """Give a temporary folder; its files move into ``folder`` if the block succeeds, and vanish if it fails.

    Files of the same names are replaced, others stay. The temporary folder lies in ``folder``, made if it is missing.
    Raises UsageError if the place cannot be written; an OSError of the block that is about another file stays as it is.
    """
    target = Path(folder)
    new = not target.exists()
    temporary = target / f".{uuid.uuid4().hex[:12]}"
    try:
        temporary.mkdir(parents=True)
        yield temporary
        with held():
            for path in sorted(temporary.iterdir()):
                path.replace(target / path.name)
            new = False
    except OSError as error:
        if not _is_about(error, target, temporary):
            raise
        raise UsageError.report(str(target), expected="a folder that can be written", received=str(error)) from error
    finally:
        with held():
            shutil.rmtree(temporary, ignore_errors=True)
            if new:
                with suppress(OSError):  # where it could not be made
                    target.rmdir()


def _is_about(error: OSError, target: Path, temporary: Path) -> bool:
    """Return whether the error came of writing to ``target`` by way of ``temporary``, and not of another file."""
    if isinstance(error.filename, str | bytes | os.PathLike):
        named = Path(os.fsdecode(error.filename))
        return named in (target, *target.parents) or temporary in (named, *named.parents)
    return error.errno in _NO_ROOM or str(temporary) in str(error)  # libraries in C put the path into the text
