"""A lock of the operating system on a results folder, for one command at a time; it ends with its process."""

from __future__ import annotations

import errno
import logging
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from ndob_fmu.errors import UsageError

_log = logging.getLogger(__name__)
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)  # as on some cluster file systems
_LOCK = ".lock"
_HOLDER = ".lock-holder"  # beside the lock, which no other process can read on Windows


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a results folder, which is made if it is missing.

    Raises UsageError, naming the holder, if another process has it, and if the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / _LOCK, timeout=0)
        lock.acquire()
    except Timeout as error:
        raise UsageError.report(
            str(folder),
            expected="a folder that no other command works on",
            received=f"one in use by {_holder(folder)}",
            likely="the same study runs in another terminal; wait for it, or use --out with another folder",
        ) from error
    except (OSError, NotImplementedError) as error:
        if not isinstance(error, NotImplementedError) and error.errno not in _NO_LOCKS:
            raise UsageError.report(
                str(folder), expected="a folder that can be written", received=str(error)
            ) from error
        _log.warning("%s: its file system has no locks; let one command at a time work on it", folder)
    try:
        with suppress(OSError):  # a full disk: other commands then cannot name the holder
            (folder / _HOLDER).write_text(
                f"process {os.getpid()} on {platform.node()} since {time.strftime('%Y-%m-%d %H:%M:%S')}", "utf-8"
            )
        yield
    finally:
        with suppress(OSError):
            (folder / _HOLDER).unlink()
        lock.release()


def _holder(folder: Path) -> str:
    try:
        return (folder / _HOLDER).read_text("utf-8")[:120]
    except (OSError, ValueError):
        return "another process"
