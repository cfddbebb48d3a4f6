"""Folders for temporary files: removed when their block ends; if the process was killed, by a later process.

A folder is ``ndob_fmu_<random>/`` with ``files/`` for its user and ``lock``, which its process holds. The first use in
a process removes folders of the same account whose lock no process holds: they belong to processes that were killed.
"""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from ndob_fmu.errors import UsageError
from ndob_fmu.support.interrupts import held

if TYPE_CHECKING:
    from filelock import FileLock

_PREFIX = "ndob_fmu_"
_LOCK, _FILES = "lock", "files"
_STALE_AFTER = 60.0  # s; a younger folder may be about to be locked
_owner = os.getpid()
_locks: dict[Path, FileLock] = {}
_swept: set[Path] = set()


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield an empty folder that is removed at the end of the block; raise UsageError if it cannot be made."""
    folder = make_folder()
    try:
        yield folder
    finally:
        remove_folder(folder)


def make_folder() -> Path:
    """Return a new empty folder, which `remove_folder` removes; raise UsageError if it cannot be made."""
    from filelock import FileLock  # slow to import, and few commands need folders

    with held():
        try:
            place = Path(tempfile.gettempdir())
            if place not in _swept:
                _swept.add(place)
                for root in place.glob(f"{_PREFIX}*"):
                    _remove_if_stale(root)
            root = place / f"{_PREFIX}{uuid.uuid4().hex[:16]}"
            root.mkdir(mode=0o700)
            lock = FileLock(root / _LOCK, timeout=0)
            _locks[root / _FILES] = lock
            with suppress(NotImplementedError):  # a file system without locks: no process can find it stale
                lock.acquire()
            (root / _FILES).mkdir()
        except OSError as error:
            raise UsageError.report(
                "the folder for temporary files",
                expected="one that can be written",
                received=str(error),
                likely="the disk is full or TMPDIR names the wrong folder",
            ) from error
    return root / _FILES


def remove_folder(folder: Path) -> None:
    """Remove a folder of `make_folder`; later processes remove what cannot be removed yet."""
    with held():
        shutil.rmtree(folder, ignore_errors=True)  # Windows cannot delete a library that is still loaded
        lock = _locks.pop(folder, None)
        if lock is not None:
            lock.release()
        if not folder.exists():
            shutil.rmtree(folder.parent, ignore_errors=True)


def remove_folders() -> None:
    """Remove all folders of this process."""
    if os.getpid() == _owner:  # not in a forked child, which may end before its parent
        for folder in list(_locks):
            remove_folder(folder)


atexit.register(remove_folders)


def _remove_if_stale(root: Path) -> None:
    from filelock import FileLock, Timeout

    with suppress(OSError, Timeout, NotImplementedError):  # it is in use, or was removed by another process meanwhile
        found = root.lstat()
        mine = not hasattr(os, "getuid") or found.st_uid == os.getuid()
        old = time.time() - found.st_mtime > _STALE_AFTER
        if not (mine and old and stat.S_ISDIR(found.st_mode) and (root / _LOCK).is_file()):
            return
        with FileLock(root / _LOCK, timeout=0):
            shutil.rmtree(root / _FILES, ignore_errors=True)
        if not (root / _FILES).exists():
            shutil.rmtree(root, ignore_errors=True)
