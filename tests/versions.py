"""Run the suite with the lowest versions that pyproject.toml allows, and with the newest ones on the newest Python.

python -m tests.versions [lowest] [newest]      both without a name; about twelve minutes on two processors

Each set has an environment in build/versions/, filled by uv. Its Python is one that uv finds or downloads; else
it is Debian's, in a folder that debootstrap fills (root only: it changes the root folder).
A lower bound that is not installed in the lowest set fails too: the suite would not have tried it.
Left out are the tests of native hosts, which `make test` runs. Tests of a browser are skipped where there is none.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "build" / "versions"
LEFT_OUT = ("fmu/test_native_host.py",)
# What the suite needs besides Python: compilers for Linux and Windows, git, and what ecos loads and calls.
PACKAGES = (
    "python3,python3-venv,python3-dev,gcc,libc6-dev,gcc-mingw-w64-x86-64-win32,git,unzip,libtbb12,ca-certificates"
)
# Run in a mount namespace of its own, so that nothing stays mounted. $1: the new root, $2: this checkout.
INSIDE = """
set -e
mkdir -p "$1$2"
mount --bind "$2" "$1$2"
mount --bind /dev "$1/dev"
mount --bind /proc "$1/proc"
[ ! -f "${SSL_CERT_FILE-}" ] || mount --bind "$SSL_CERT_FILE" "$1/etc/ssl/certs/ca-certificates.crt"
[ ! -f "${SSL_CERT_FILE-}" ] || export SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt
root=$1 checkout=$2
shift 2
exec chroot "$root" env -C "$checkout" -u TMPDIR PATH=/usr/sbin:/usr/bin:/sbin:/bin "$@"
"""


@dataclass(frozen=True)
class VersionSet:
    """pythons: versions that uv looks for, in this order; suite: the release of Debian that has one otherwise."""

    name: str
    pythons: tuple[str, ...]
    suite: str
    resolution: str


SETS = (
    VersionSet("lowest", ("3.10", "3.11"), "bookworm", "lowest-direct"),
    VersionSet("newest", ("3.14",), "testing", "highest"),
)


class UnavailableError(Exception):
    """This machine has no Python for a set, and should have one."""


def for_uv() -> dict[str, str]:
    """Return the variables of this process; pip's index and certificates hold for uv too."""
    found = dict(os.environ)
    for option, variable in (("index-url", "UV_DEFAULT_INDEX"), ("cert", "SSL_CERT_FILE")):
        for key in (f"global.{option}", f":env:.{option}"):
            command = [sys.executable, "-m", "pip", "config", "get", key]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode == 0:
                found.setdefault(variable, done.stdout.strip())
    # Pythons of pyenv that are not the chosen one are found by uv only where PATH names them.
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    found["PATH"] = os.pathsep.join([*map(str, pyenv.glob("versions/3.*/bin")), found["PATH"]])
    return {**found, "UV_PYTHON_INSTALL_DIR": str(FOLDER / "python"), "UV_NO_PROGRESS": "1", "UV_LINK_MODE": "copy"}


def uv() -> Path:
    """Return the program uv, installed in an environment of its own."""
    program = FOLDER / "uv" / "bin" / "uv"
    if not program.is_file():
        venv.create(program.parents[1], clear=True, with_pip=True)
        pip = [program.with_name("python"), "-m", "pip"]
        subprocess.run([*pip, "install", "--quiet", "--disable-pip-version-check", "uv>=0.5"], check=True)
    return program


def why_no_other_root() -> str:
    """Return in one line why this machine cannot run Debian in a folder, or nothing."""
    if not Path("/etc/debian_version").is_file():
        return "this machine does not run Debian"
    if os.geteuid() != 0:
        return "only root can run Debian in a folder"
    if subprocess.run(["unshare", "--mount", "true"], capture_output=True, check=False).returncode:
        return "this machine lets root mount nothing"
    return ""


def other_root(suite: str) -> list[str]:
    """Return the words before a command that run it in a folder with a release of Debian, filled once."""
    root, stamp = FOLDER / suite, FOLDER / f"{suite}.installed"
    if not stamp.is_file():
        shutil.rmtree(root, ignore_errors=True)
        program = shutil.which("debootstrap", path="/usr/sbin" + os.pathsep + os.environ["PATH"])
        if program is None:
            raise UnavailableError("debootstrap is missing: apt-get install debootstrap")
        command = [program, "--variant=minbase", f"--include={PACKAGES}", suite, str(root)]
        with (FOLDER / f"{suite}.log").open("w") as log:
            if subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=False).returncode:
                raise UnavailableError(f"debootstrap cannot install Debian {suite}: {log.name}")
        stamp.touch()  # last, so that an installation that was interrupted is tried again
    shutil.copy("/etc/resolv.conf", root / "etc" / "resolv.conf")
    return ["unshare", "--mount", "sh", "-c", INSIDE, "sh", str(root), str(ROOT)]


def python_of(wanted: VersionSet) -> tuple[list[str], str] | None:
    """Return (the words before each command, the Python) of a set; None where this kind of machine can have none."""
    variables = for_uv()
    for version in wanted.pythons:
        find = [uv(), "python", "find", "--system", "--no-project", version]
        for command in (find, [uv(), "python", "install", "--no-bin", version], find):
            done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
            if done.returncode == 0 and command is find:
                return [], done.stdout.strip()
    if reason := why_no_other_root():
        versions = " or ".join(wanted.pythons)
        print(
            f"versions, {wanted.name}: nothing is tried; uv neither finds nor downloads Python {versions}, and {reason}"
        )
        return None
    return other_root(wanted.suite), "/usr/bin/python3"


def run(wanted: VersionSet) -> int:
    """Run the suite with one set of versions, print a closing line, and return the exit code."""
    try:
        found = python_of(wanted)
    except UnavailableError as error:
        print(f"versions, {wanted.name}: nothing is tried; {error}")
        return int(os.environ.get("CI") == "true")
    if found is None:
        return 0
    before, base = found
    folder = FOLDER / wanted.name
    python = [*before, str(folder / "bin" / "python")]
    install = ["pip", "install", "--quiet", "--python", str(folder), "--resolution", wanted.resolution, "-e", ".[test]"]
    for words in (["venv", "--quiet", "--seed", "--clear", "--python", base, str(folder)], install):
        if subprocess.run([*before, str(uv()), *words], cwd=ROOT, env=for_uv(), check=False).returncode:
            print(f"versions, {wanted.name}: uv cannot install the packages, see its message above")
            return 1
    code = 0
    if wanted.resolution == "lowest-direct":
        code = subprocess.run([*python, "-m", "tests.lower_bounds"], cwd=ROOT, check=False).returncode
    show = [*python, "-c", "import platform; print(platform.python_version())"]
    version = subprocess.run(show, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    left_out = [f"--ignore=tests/{name}" for name in LEFT_OUT]
    pytest = [*python, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "-p", "no:cacheprovider", *left_out]
    # Not as in CI, where a skipped test is a failure: Debian's folder has no browser.
    counts = "pytest did not run to its end"
    with subprocess.Popen(
        pytest, cwd=ROOT, env={**os.environ, "CI": ""}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as running:
        for line in running.stdout or ():
            print(line, end="", flush=True)
            if re.search(r"\d+ (passed|failed|errors?)\b.* in [\d.]+s", line):
                counts = line.strip(" =\n")
    print(f"versions, {wanted.name}: Python {version}, {counts}")
    return running.returncode or code


def main(names: list[str]) -> int:
    """Run the sets of these names, all without a name; return the exit code."""
    known = [one.name for one in SETS]
    if unknown := set(names) - set(known):
        print(f"versions: expected {' or '.join(known)}, received {min(unknown)!r}")
        return 2
    FOLDER.mkdir(parents=True, exist_ok=True)
    return max([run(one) for one in SETS if one.name in (names or known)])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
