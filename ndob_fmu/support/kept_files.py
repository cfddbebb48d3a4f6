"""Files in the user's cache folder: what takes long to make, by a key that says all that it was made from.

A file is written whole or not at all, and begins with the digest of its content. So processes may write at once, and a
damaged file counts as missing. Where the folder cannot be used, nothing is kept.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path

from ndob_fmu.errors import UsageError
from ndob_fmu.support.files import atomic_path

_MOST = 128  # files of less than a megabyte; the oldest make room
_DIGEST = hashlib.sha256().digest_size
_UNUSABLE = (OSError, RuntimeError, UsageError)  # RuntimeError: the account has no home


def kept(key: str) -> bytes | None:
    """Return what was kept under a key, None where there is nothing."""
    with suppress(*_UNUSABLE):
        data = (_folder() / key).read_bytes()
        digest, content = data[:_DIGEST], data[_DIGEST:]
        if digest == hashlib.sha256(content).digest():
            return content
    return None


def keep(key: str, content: bytes) -> None:
    """Keep the content under a key; do nothing where the folder cannot be written."""
    with suppress(*_UNUSABLE):
        folder = _folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with atomic_path(folder / key) as temporary:
            temporary.write_bytes(hashlib.sha256(content).digest() + content)
        files = sorted(folder.glob("[!.]*"), key=lambda path: path.stat().st_mtime)
        for old in files[:-_MOST]:
            old.unlink()


def _folder() -> Path:
    cache = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    return Path(cache) / "ndob-fmu"
