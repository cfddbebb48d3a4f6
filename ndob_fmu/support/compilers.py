"""What a C compiler's output depends on besides its sources: part of the key of a binary that is kept."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

# Variables that change what gcc and clang find.
_READ_BY_COMPILERS = ("PATH", "CPATH", "C_INCLUDE_PATH", "LIBRARY_PATH", "COMPILER_PATH", "GCC_EXEC_PREFIX")


def compiler_identity(command: Sequence[str]) -> str:
    """Return a text that is another one where another compiler, or other variables, stand behind a command."""
    programs = [Path(found).resolve() for word in command if (found := shutil.which(word))]
    files = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in programs if path.exists()]
    return repr((list(command), files, [os.environ.get(name) for name in _READ_BY_COMPILERS]))
