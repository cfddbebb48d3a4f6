"""Marks for tests that need more of the machine than Python's packages: they skip with the reason if it is missing.

Under CI=true a skipped test is a failure (conftest.py). docs/installing.md lists what the tests need.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import sys

import pytest


def found_c_compiler() -> bool:
    """Return whether `cc`, or the compiler that CC names, can be found."""
    return shutil.which(shlex.split(os.environ.get("CC", "cc"))[0]) is not None


def _tbb() -> bool:
    try:
        ctypes.CDLL("libtbb.so.12")
    except OSError:
        return False
    return True


def _missing(reason: str, found: bool) -> pytest.MarkDecorator:
    return pytest.mark.skipif(not found, reason=reason)


C_COMPILER = _missing("expected a C compiler, cc or the one that CC names (Debian: gcc, libc6-dev)", found_c_compiler())
WINDOWS_COMPILER = _missing(
    "expected MinGW's x86_64-w64-mingw32-gcc (Debian: gcc-mingw-w64-x86-64)",
    shutil.which("x86_64-w64-mingw32-gcc") is not None,
)
CMAKE = _missing(
    "expected cmake and a C++ compiler, which it looks for (Debian: cmake, g++)",
    bool(shutil.which("cmake") and shutil.which("c++")),
)
FRONT = _missing(
    "the front of FMUs: expected Linux and a C compiler, cc or the one that CC names (Debian: gcc, libc6-dev)",
    sys.platform == "linux" and found_c_compiler(),
)
# gcc compiles for ARM, and qemu runs the programs.
ARM_IN_QEMU = _missing(
    "expected qemu-aarch64, aarch64-linux-gnu-gcc and its C library (Debian: qemu-user, gcc-aarch64-linux-gnu, "
    "libc6-dev-arm64-cross)",
    bool(shutil.which("qemu-aarch64") and shutil.which("aarch64-linux-gnu-gcc")),
)
ECOS = _missing(
    "expected libtbb.so.12 and unzip, which ecos uses (Debian: libtbb12, unzip)", _tbb() and bool(shutil.which("unzip"))
)
