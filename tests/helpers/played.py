"""Native FMUs in the C host: tables of inputs in, tables of outputs out, on this machine or in an emulator."""

from __future__ import annotations

import os
import shlex
import subprocess
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from fmpy import read_model_description

from ndob_fmu.fmu import compile_front as front
from tests.helpers.native_experiments import Experiment
from tests.helpers.native_host import SOURCE

COUNTER = SOURCE.with_name("count_memory.c")
ARM = "aarch64-linux"
_SET = {"Real": "setR", "Integer": "setI", "Enumeration": "setI", "Boolean": "setB", "String": "setS"}


@dataclass(frozen=True)
class Machine:
    """Where the C host runs.

    binaries: the folder in the FMU, and the suffix, of what is loaded there
    words: what starts the host
    path: how a program there names a path
    """

    binaries: tuple[str, str]
    words: tuple[str, ...]
    path: Callable[[Path], str] = str
    env: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Played:
    """What a run of the host gave.

    rows: of each instance, after each step: the outputs, one column for each of names
    blocks: how many blocks of memory were asked for during the steps, if the host counts them
    said: the FMU's messages
    """

    names: list[str]
    rows: list[np.ndarray]
    blocks: int
    said: list[str]


def this_machine(folder: Path) -> Machine:
    """Return x86-64 Linux itself; the host is compiled into the folder."""
    host = _compiled(shlex.split(os.environ.get("CC", "cc")), folder / "host")
    return Machine(("linux64", ".so"), (str(host),))


def arm_in_qemu(folder: Path) -> Machine:
    """Return 64-bit ARM, emulated; the host is compiled into the folder."""
    host = _compiled(["aarch64-linux-gnu-gcc"], folder / "host-arm")
    return Machine((ARM, ".so"), ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu", str(host)))


def _compiled(compiler: Sequence[str], target: Path) -> Path:
    flags = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", "-I", str(front.HEADERS)]
    subprocess.run([*compiler, *flags, str(SOURCE), "-o", str(target), "-ldl", "-lpthread", "-lm"], check=True)
    return target


def memory_counter(folder: Path) -> dict[str, str]:
    """Return the environment in which the host of this machine counts the blocks of memory that it asks for."""
    target = folder / "count_memory.so"
    compiler = shlex.split(os.environ.get("CC", "cc"))
    subprocess.run([*compiler, "-O2", "-Wall", "-Wextra", "-shared", "-fPIC", COUNTER, "-o", target], check=True)
    return {"LD_PRELOAD": str(target)}


@dataclass(frozen=True)
class Loaded:
    """A native FMU, unpacked in `folder`, for a machine."""

    machine: Machine
    folder: Path

    @classmethod
    def unpacked(cls, machine: Machine, fmu: Path, folder: Path) -> Loaded:
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folder)
        return cls(machine, folder)

    def command(self) -> list[str]:
        """Return the words that start the host with this FMU."""
        description = read_model_description(str(self.folder))
        place, suffix = self.machine.binaries
        library = self.folder / "binaries" / place / f"{description.modelName}{suffix}"
        return [*self.machine.words, self.machine.path(library), "-", description.guid]

    def run(self, commands: Sequence[str]) -> tuple[list[str], list[str]]:
        """Run the host with these commands and return its replies, all OK or a Warning, and the FMU's messages."""
        done = subprocess.run(
            self.command(),
            input="".join(f"{command}\n" for command in commands),
            env={"PATH": os.environ["PATH"], **self.machine.env},
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, ""), done.stdout[-500:] + done.stderr[-500:]
        lines = done.stdout.splitlines()
        said = [line for line in lines if line.startswith("log ")]
        replies = [line for line in lines if line not in said]
        assert all(reply.endswith((" OK", " Warning")) for reply in replies), lines[-10:]
        return replies, said

    def begin(self, experiment: Experiment) -> Iterator[str]:
        """Yield the commands that bring a new instance to its first step."""
        variables = {v.name: v for v in read_model_description(str(self.folder)).modelVariables}
        yield "new fmu - on"
        yield "setup 0"
        for name, value in experiment.start_values.items():
            text = self.machine.path(value) if isinstance(value, Path) else repr(value)
            yield f"{_SET[variables[name].type]} {variables[name].valueReference} {text}"
        yield from ("enter", "exit")

    def play(self, experiment: Experiment, how: str = "here", instances: int = 1) -> Played:
        """Run an experiment; how: as host.c says."""
        variables = {v.name: v for v in read_model_description(str(self.folder)).modelVariables}
        table, result = self.folder / "table", self.folder / "result"
        np.column_stack([np.zeros((experiment.rows, 0)), *experiment.inputs.values()]).tofile(table)
        outputs = [v for v in variables.values() if v.causality == "output"]
        shown = [v for v in outputs if v.type == "Real"] + [v for v in outputs if v.type == "Boolean"]
        lists = [
            [variables[name] for name in experiment.inputs],
            *([v for v in outputs if v.type == t] for t in ("Real", "Boolean")),
        ]
        words = [",".join(str(v.valueReference) for v in each) or "-" for each in lists]
        paths = [self.machine.path(path) for path in (table, result)]
        play = f"play {paths[0]} {experiment.rows} {experiment.step_size!r} {' '.join(words)} {paths[1]} {how}"
        (*_, played), said = self.run([*instances * list(self.begin(experiment)), play])
        rows = np.fromfile(result).reshape(instances, experiment.rows, len(shown))
        return Played([v.name for v in shown], list(rows), int(played.split()[0]), said)
