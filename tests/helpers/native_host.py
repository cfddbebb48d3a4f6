"""The C host of the tests, and FMUs unpacked for it: a process that has no Python until the FMU brings it.

python -m tests.helpers.native_host [COUNT]    run and leave COUNT times (100) in the C host and in fmpy, and print how
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ndob_fmu.fmu import compile_front as front

SOURCE = Path(__file__).parent / "native" / "host.c"
LOGGED = re.compile(r"log (\w+) (\w+) (.*)")
RUN_AND_LEAVE = ("new fmu", "setup 0", "enter", "exit", "run 20 0.001 0,1 3,4", "terminate", "free")
IN_FMPY = "import sys; from fmpy import simulate_fmu; simulate_fmu(sys.argv[1], stop_time=0.02, output_interval=0.001)"


@dataclass(frozen=True)
class Run:
    """The results of a run of the host: its exit code, its replies, and its log messages."""

    code: int
    replies: list[str]
    log: list[tuple[str, str, str]]


@dataclass(frozen=True)
class Native:
    """An FMU unpacked in `folder`, and the host that runs it."""

    host: Path
    folder: Path

    @property
    def library(self) -> Path:
        (stock,) = self.folder.glob("binaries/linux64/pythonfmu-export.so")
        (library,) = set(stock.parent.iterdir()) - {stock}
        return library

    @property
    def resources(self) -> Path:
        return self.folder / "resources"

    @property
    def front(self) -> Path:
        return self.resources / "front.txt"

    @property
    def guid(self) -> str:
        return re.findall("guid=(.*)", self.front.read_text("utf-8"))[0]

    def references(self, *names: str) -> str:
        variables = re.findall(r"variable=.. (.*)", self.front.read_text("utf-8"))
        return ",".join(str(variables.index(name)) for name in names)

    def run(
        self, *commands: str, uri: str | None = None, guid: str | None = None, env: Mapping[str, str] | None = None
    ) -> Run:
        """Run the host with these commands; its environment has only `env`."""
        done = subprocess.run(
            [self.host, self.library, uri or self.resources.as_uri(), guid or self.guid],
            input="".join(f"{command}\n" for command in commands).encode(),
            env=dict(env or {}),
            capture_output=True,
            timeout=120,
            check=False,
        )
        lines = done.stdout.decode().splitlines()
        logged = [LOGGED.fullmatch(line) for line in lines]
        return Run(
            done.returncode,
            [line for line, found in zip(lines, logged, strict=True) if not found],
            [(found[1], found[2], found[3]) for found in logged if found],
        )


def compile_host(folder: Path) -> Path:
    """Compile the host with the system's compiler."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    flags = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", "-I", str(front.HEADERS)]
    target = folder / "host"
    subprocess.run([*compiler, *flags, str(SOURCE), "-o", str(target), "-ldl", "-lpthread", "-lm"], check=True)
    return target


def unpack(fmu: Path, folder: Path, host: Path) -> Native:
    """Unpack the FMU into the folder."""
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    return Native(host, folder)


def moved(native: Native, folder: Path) -> Native:
    """Return a copy of it in another folder."""
    shutil.copytree(native.folder, folder)
    return Native(native.host, folder)


def main(count: int) -> int:
    """Print the number of each exit code in `count` runs of either host; return 1 if one was not 0."""
    from ndob_fmu import build, load_model

    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        folder = Path(work)
        observer = build(load_model("flexible_joint"), folder)[1]
        native = unpack(observer, folder / "unpacked", compile_host(folder))
        in_host = Counter(native.run(*RUN_AND_LEAVE).code for _ in range(count))
        command = [sys.executable, "-c", IN_FMPY, str(observer)]
        in_fmpy = Counter(subprocess.run(command, check=False).returncode for _ in range(count))
    print(f"exit codes of {count} runs: C host {dict(in_host)}, fmpy {dict(in_fmpy)}")
    return int(set(in_host) | set(in_fmpy) != {0})


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 100))
