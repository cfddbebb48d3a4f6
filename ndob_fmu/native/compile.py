"""The binaries of a native FMU, one for each platform: zig's compiler for all of them, or the system's for this one."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import struct
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from ndob_fmu.errors import UsageError
from ndob_fmu.support.compilers import compiler_identity
from ndob_fmu.support.kept_files import keep, kept
from ndob_fmu.support.temporary import temporary_folder


@dataclass(frozen=True)
class Platform:
    """How a binary is made for a platform.

    folders: the platform's folder in binaries/ in FMI 2 and in FMI 3
    suffix: of a library there
    targets: zig's names of its processors; of several, one universal binary is made
    options: of the compiler
    runs_here: `sys.platform` and processor on which the system's compiler makes it
    cross: another compiler that makes it anywhere, with options of its own; empty for none
    """

    folders: tuple[str, str]
    suffix: str
    targets: tuple[str, ...]
    options: tuple[str, ...]
    runs_here: tuple[str, str]
    cross: tuple[str, ...] = ()


PLATFORMS: Mapping[str, Platform] = {
    "linux64": Platform(
        ("linux64", "x86_64-linux"),
        ".so",
        ("x86_64-linux-gnu.2.17",),
        ("-fPIC", "-fno-asynchronous-unwind-tables", "-fno-unwind-tables", "-Wl,--build-id=none"),
        ("linux", "x86_64"),
    ),
    "win64": Platform(
        ("win64", "x86_64-windows"),
        ".dll",
        ("x86_64-windows-gnu",),
        # longjmp goes back to where it was without the tables for unwinding, which take a twentieth of the library.
        (
            *("-D_WIN32_WINNT=0x0601", "-D__USE_MINGW_ANSI_STDIO=1", "-D__USE_MINGW_SETJMP_NON_SEH"),
            "-fno-asynchronous-unwind-tables",
        ),
        ("win32", "AMD64"),
        ("x86_64-w64-mingw32-gcc", "-static", "-Wl,--no-insert-timestamp", "-Wl,--disable-auto-image-base"),
    ),
    "darwin64": Platform(
        ("darwin64", "x86_64-darwin"),
        ".dylib",
        ("x86_64-macos.11.0", "aarch64-macos.11.0"),
        ("-Wl,-install_name,@rpath/model.dylib",),
        ("darwin", ""),
    ),
    "aarch64-linux": Platform(
        ("aarch64-linux", "aarch64-linux"),
        ".so",
        ("aarch64-linux-gnu.2.17",),
        (
            "-fPIC",
            "-fno-asynchronous-unwind-tables",
            "-fno-unwind-tables",
            "-mno-outline-atomics",
            "-Wl,--build-id=none",
        ),
        ("linux", "aarch64"),
        ("aarch64-linux-gnu-gcc",),
    ),
}
_OPTIONS = ("-std=c11", "-ffp-contract=off", "-shared", "-fvisibility=hidden", "-s", "-Wall", "-Wextra")


def this_platform() -> str:
    """Return the name in PLATFORMS of the platform that this process runs on; "" where it is none of them."""
    system, machine = sys.platform, platform.machine()
    return next((name for name, one in PLATFORMS.items() if one.runs_here in ((system, machine), (system, ""))), "")


def has_compiler(target: str) -> bool:
    """Return whether a compiler is found for a platform, one of PLATFORMS or none of them."""
    try:
        return target in PLATFORMS and bool(_compilers(PLATFORMS[target], target))
    except UsageError:
        return False


def binary(name: str, files: Mapping[str, str], target: str, *, level: str = "-Os") -> bytes:
    """Return a library, as that of a native FMU, for a platform, one of PLATFORMS.

    name: of the FMU, which is that of its C file too
    files: C files by their names
    level: the compiler's option for short code or fast code

    Raises UsageError where no compiler makes it.
    """
    chosen = PLATFORMS[target]
    with temporary_folder() as work:
        for file, text in files.items():
            Path(work, file).write_text(text, "utf-8")
        built = [
            _compiled(Path(work), f"{name}.c", f"{place}{chosen.suffix}", [*command, level, *chosen.options], target)
            for place, command in enumerate(_compilers(chosen, target))
        ]
        return built[0] if len(built) == 1 else universal(built)


def _compilers(chosen: Platform, target: str) -> list[list[str]]:
    """Return the commands that compile for the platform, one for each of its processors."""
    if importlib.util.find_spec("ziglang"):
        return [[sys.executable, "-m", "ziglang", "cc", "-target", each] for each in chosen.targets]
    system, processor = chosen.runs_here
    is_here = sys.platform == system and processor in ("", platform.machine())
    wish = shlex.split(os.environ.get("CC", ""))
    compiler = wish or [each for each in ("cc", "gcc", "clang") if shutil.which(each)][:1]
    if is_here and compiler and shutil.which(compiler[0]):
        return [compiler]
    if chosen.cross and shutil.which(chosen.cross[0]):
        return [list(chosen.cross)]
    raise UsageError.report(
        f"--platforms {target}",
        expected="zig's compiler"
        + (f" or {chosen.cross[0]}" if chosen.cross else "")
        + (", or a C compiler as CC or cc" if is_here else ""),
        received="none",
        likely="the extra is not installed: pip install 'ndob-fmu[native]'",
    )


def _compiled(work: Path, source: str, output: str, command: Sequence[str], target: str) -> bytes:
    """Return a library; what the same compiler made of the same sources is taken from the user's cache folder."""
    whole = [*command, *_OPTIONS, source, "-o", output, *(() if target == "win64" else ("-lm",))]
    key = _key(work, whole)
    known = kept(key)
    if known is not None:
        return known
    done = subprocess.run(
        whole,
        cwd=work,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    library = work / output
    if done.returncode == 0 and library.exists():
        keep(key, found := library.read_bytes())
        return found
    said = next((line for line in done.stderr.splitlines() if "error" in line), f"exit code {done.returncode}")
    raise UsageError.report(f"--platforms {target}", expected=f"{command[0]} to compile {source}", received=said)


def _key(work: Path, command: Sequence[str]) -> str:
    """Return a digest of what a library is made from: the C files, the command, and the compiler behind it."""
    digest = hashlib.sha256(compiler_identity(command).encode())
    if "ziglang" in command:
        digest.update(version("ziglang").encode())
    for path in sorted(work.glob("*.[ch]")):
        digest.update(f"\0{path.name}\0".encode() + path.read_bytes())
    return f"native-{digest.hexdigest()}"


# The header of a universal binary (Apple's <mach-o/fat.h>), and the alignment of its parts, 2¹⁴ bytes.
_FAT_MAGIC, _ALIGNMENT = 0xCAFEBABE, 14


def universal(thin: Sequence[bytes]) -> bytes:
    """Return one binary for macOS made of Mach-O binaries for one processor each."""
    size = 1 << _ALIGNMENT
    header, parts, place = struct.pack(">II", _FAT_MAGIC, len(thin)), b"", size
    for each in thin:
        processor, subtype = struct.unpack("<II", each[4:12])
        header += struct.pack(">IIIII", processor, subtype, place, len(each), _ALIGNMENT)
        padded = each + bytes(-len(each) % size)
        parts += padded
        place += len(padded)
    return header.ljust(size, b"\0") + parts
