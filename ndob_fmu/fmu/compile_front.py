"""The front of an FMU: a small C library between a host and pythonfmu's binary, for Linux and for Windows.

It lies where the host looks for the FMU's binary, pythonfmu's own beside it. Its sources are `shell/`, FMI's functions
and rules, and `python_core/`, which runs the slave. The build compiles them: for Linux with the system's compiler, for
Windows with a MinGW cross compiler. Without the compiler of a platform the FMU keeps pythonfmu's binary there, and what
the front does is lost.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np

from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.fmu.rules_header import NAME, ROLE_LETTERS, rules_header
from ndob_fmu.interface.fmi_rules import role
from ndob_fmu.support.compilers import compiler_identity
from ndob_fmu.support.kept_files import keep, kept
from ndob_fmu.support.temporary import temporary_folder

_log = logging.getLogger(__name__)

SOURCES = Path(__file__).parent
FOLDERS = ("shell", "python_core")
HEADERS = Path(fmpy.__file__).parent / "c-code"
DESCRIPTION = "resources/front.txt"
# No path, no time and no name of this machine goes into a binary; -s drops the names of temporary files.
_FLAGS = ("-std=gnu11", "-O2", "-shared", "-fvisibility=hidden", "-Wall", "-Wextra", "-s")


@dataclass(frozen=True)
class Platform:
    """How the front is compiled for one of FMI's platforms, and what an FMU loses without it.

    name: FMI's, of the folder in binaries/
    suffix: of a library there
    variable: the environment variable that names the compiler
    compilers: the commands that are tried without it
    other: the ending of the sources that are for another platform
    flags, libraries: of the compiler command, besides those of all platforms
    lost: the warning where no front can be compiled; %s is the reason
    """

    name: str
    suffix: str
    variable: str
    compilers: tuple[str, ...]
    other: str
    flags: tuple[str, ...]
    libraries: tuple[str, ...]
    lost: str

    @property
    def slave_binary(self) -> str:
        """Where pythonfmu's own binary lies in an FMU that has a front."""
        return f"binaries/{self.name}/pythonfmu-export{self.suffix}"


LINUX = Platform(
    name="linux64",
    suffix=".so",
    variable="CC",
    compilers=("cc", "gcc", "clang"),
    other="_windows.c",
    flags=(
        "-fPIC",
        "-Wl,-z,nodelete",  # ecos closes the library while instances of it live on
        "-Wl,--build-id=none",
    ),
    libraries=("-ldl", "-lpthread", "-lm"),
    lost="the FMUs get no front for Linux: they load in Python processes only, guard no calls and must not lie in a "
    "folder with ä # + [ ( , ' in its name; %s",
)
WINDOWS = Platform(
    name="win64",
    suffix=".dll",
    variable="CC_WIN64",
    compilers=("x86_64-w64-mingw32-gcc",),
    other="_linux.c",
    flags=(
        "-static",
        "-D__USE_MINGW_ANSI_STDIO=1",
        "-D_WIN32_WINNT=0x0602",  # Windows 8
        "-Wno-format",  # it takes %zu for unknown
        "-Wl,--no-insert-timestamp",
        "-Wl,--disable-auto-image-base",  # which depends on the path of the output
    ),
    libraries=(),
    lost="the FMUs get no front for Windows: there they find only a Python on PATH, guard no calls and must not lie in "
    "a folder with ä # ' in its name; %s",
)
# What was compiled in this process, by platform and wished compiler.
_compiled: dict[tuple[Platform, str], bytes | None] = {}
_TYPES = {"Real": "R", "Integer": "I", "Enumeration": "I", "Boolean": "B", "String": "S"}


def with_front(contents: Mapping[str, bytes], fmu: FmuDescription, guid: str) -> dict[str, bytes]:
    """Return the FMU's files with fronts before pythonfmu's binaries.

    The one for Linux is built on x86-64 Linux only. Where nothing compiles a front there is a warning.
    """
    here = (sys.platform, platform.machine()) == ("linux", "x86_64")
    possible = (LINUX, WINDOWS) if here else (WINDOWS,)
    binaries = {f"binaries/{target.name}/{fmu.name}{target.suffix}": target for target in possible}
    targets = {binary: target for binary, target in binaries.items() if binary in contents}
    result = dict(contents)
    for (binary, target), front in zip(targets.items(), compiled(tuple(targets.values())), strict=True):
        if front is not None:
            result |= {binary: front, target.slave_binary: contents[binary]}
            result[DESCRIPTION] = description(fmu, guid, contents).encode()
    return result


def description(fmu: FmuDescription, guid: str, contents: Mapping[str, bytes]) -> str:
    """Return front.txt: what the front has to know of the FMU and its files, and the Python that it tries first."""
    files = [name.removeprefix("resources/") for name in contents if name.startswith("resources/")]
    lines = [
        f"guid={guid}",
        *(f"{name}={path}" for name, path in building_python().items()),
        f"entry={contents['resources/slavemodule.txt'].decode().strip()}",
        f"files={'|'.join(sorted(files))}",
    ]
    lines += [f"variable={_TYPES[v.type]}{ROLE_LETTERS[role(v)]} {v.name}" for v in fmu.variables]
    lines.append(f"variables={len(fmu.variables)}")
    return "\n".join(lines) + "\n"


def building_python() -> dict[str, str]:
    """Return executable, libpython and the folder that NumPy lies in; empty where there is none."""
    value = sysconfig.get_config_var
    folders = [value("LIBDIR"), str(Path(sys.base_prefix) / "lib")]
    names = [name for name in (value("INSTSONAME"), value("LDLIBRARY")) if name and ".so" in name]
    libraries = [Path(folder) / name for name in names for folder in folders if folder]
    return {
        "python": sys.executable,
        "libpython": str(next((path for path in libraries if path.exists()), "")),
        "packages": str(Path(np.__file__).parents[1]),
    }


def sources(target: Platform = LINUX) -> list[str]:
    """Return the C files of a platform, by their path in `SOURCES`."""
    files = [path for folder in FOLDERS for path in sorted((SOURCES / folder).glob("*.c"))]
    return [path.relative_to(SOURCES).as_posix() for path in files if not path.name.endswith(target.other)]


def write_rules(folder: Path) -> Path:
    """Write the header with FMI's rules, which the sources include, into the folder and return the folder."""
    (folder / NAME).write_text(rules_header(), "utf-8")
    return folder


def compiled(targets: Sequence[Platform]) -> list[bytes | None]:
    """Return the front's binary for each platform; None, with a warning, where it cannot be compiled.

    The compilers run at once. What they made before, from the same sources, is taken from the user's cache folder.
    """
    wished = [(target, os.environ.get(target.variable, "")) for target in targets]
    with ExitStack() as running:
        begun = {key: running.enter_context(_compiling(*key)) for key in wished if key not in _compiled}
        _compiled.update({key: binary() for key, binary in begun.items()})
    return [_compiled[key] for key in wished]


def forget_compiled() -> None:
    """Let the next front be compiled anew, for example from other sources."""
    _compiled.clear()


@contextmanager
def _compiling(target: Platform, wish: str) -> Iterator[Callable[[], bytes | None]]:
    """Run the compiler command `wish`, or the first one found where that is empty; yield what waits for the binary."""
    compiler = shlex.split(wish) or [name for name in target.compilers if shutil.which(name)][:1]
    if not compiler or not shutil.which(compiler[0]):
        tried = f"{target.variable}={wish}, which is not here" if wish else f"none of {', '.join(target.compilers)}"
        _log.warning(target.lost, f"expected a C compiler, received {tried}")
        yield lambda: None
        return
    key = _key(target, compiler)
    known = kept(key)
    if known is not None:
        yield lambda: known
        return
    with temporary_folder() as work:
        binary = Path(work, f"front{target.suffix}")
        include = ["-I", str(HEADERS), "-I", str(write_rules(Path(work)))]
        command = [*compiler, *_FLAGS, *target.flags, f"-ffile-prefix-map={SOURCES}=.", *include, *sources(target)]
        with subprocess.Popen(
            [*command, "-o", str(binary), *target.libraries],
            cwd=SOURCES,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        ) as process:

            def finished() -> bytes | None:
                _, text = process.communicate()
                if process.returncode == 0 and binary.exists():
                    keep(key, found := binary.read_bytes())
                    return found
                said = next((line for line in text.splitlines() if "error" in line), f"exit code {process.returncode}")
                _log.warning(target.lost, f"expected {compiler[0]} to compile it, received {said}")
                return None

            try:
                yield finished
            finally:
                process.kill()


def _key(target: Platform, compiler: Sequence[str]) -> str:
    """Return a digest of what a front is made from: sources, headers, command, and the compiler by its file."""
    whole = hashlib.sha256(rules_header().encode())
    for folder in (*(SOURCES / name for name in FOLDERS), HEADERS):
        for path in sorted(folder.glob("*.[ch]")):
            whole.update(f"\0{path.name}\0".encode() + path.read_bytes())
    whole.update(repr((target, _FLAGS, compiler_identity(compiler))).encode())
    return f"front-{whole.hexdigest()}"
