"""Long runs of the FMUs in a process of their own, and how its memory grows.

python -m tests.soak [--steps N] [--fmus FOLDER]

N steps (1000000) of a plant, an observer and each component, in fmpy and in a native host, a tenth of it with varying
steps and samples that are not finite, and ten rounds of 100 instances.

Prints the growth after a warm-up of a tenth, at most 2000 steps, and ends with 1 if a run grows by a megabyte or more.
"""

from __future__ import annotations

import argparse
import ctypes
import functools
import gc
import json
import subprocess
import sys
import tempfile
import time
import zipfile
from ctypes import c_double, c_size_t, c_uint
from dataclasses import asdict, dataclass
from math import nan
from pathlib import Path
from random import Random

from fmpy import fmi2, read_model_description
from fmpy.model_description import ModelDescription

from ndob_fmu import build, load_model
from ndob_fmu.fmu.components import build_components, records
from tests.helpers.component_settings import moved
from tests.helpers.native_host import compile_host, unpack

ROOT = Path(__file__).parents[1]
H = 1e-3
WARM_UP = 2000
LIMIT = 1_000_000
SETTINGS = {record.name: moved(record.variables) for record in records()}
ORDERS = ("first in, first out", "last in, first out", "mixed")


class _Heap(ctypes.Structure):
    """The C library's mallinfo2."""

    _fields_ = (
        *((name, c_size_t) for name in ("arena", "ordblks", "smblks", "hblks")),
        ("mapped", c_size_t),
        *((name, c_size_t) for name in ("usmblks", "fsmblks")),
        ("used", c_size_t),
        *((name, c_size_t) for name in ("fordblks", "keepcost")),
    )


@dataclass(frozen=True)
class Memory:
    """Of a process: blocks of Python's allocator, bytes of malloc's, and resident bytes."""

    blocks: int
    heap: int
    resident: int

    def __sub__(self, other: Memory) -> Memory:
        return Memory(*(a - b for a, b in zip(asdict(self).values(), asdict(other).values(), strict=True)))


def memory() -> Memory:
    """Of this process. Blocks and heap are exact: one float a step that stays is seen in a thousand steps."""
    gc.collect()
    mallinfo = ctypes.CDLL(None).mallinfo2
    mallinfo.restype = _Heap
    heap = mallinfo()
    return Memory(sys.getallocatedblocks(), heap.used + heap.mapped, resident("self"))


def resident(process: int | str) -> int:
    pages = Path(f"/proc/{process}/statm").read_text("utf-8").split()[1]
    return int(pages) * 4096


@functools.cache
def _description(folder: Path) -> ModelDescription:
    return read_model_description(str(folder))


def _references(description: ModelDescription, causality: str) -> list[int]:
    real = (v for v in description.modelVariables if v.type == "Real")
    return [v.valueReference for v in real if v.causality == causality]


class Stepped:
    """An instance in fmpy, with buffers made once."""

    def __init__(self, folder: Path, name: str = "soak") -> None:
        description = _description(folder)
        self.fmu = fmi2.FMU2Slave(
            instanceName=name,
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=str(folder),
        )
        self.fmu.instantiate()
        self.settings = SETTINGS.get(description.modelName, {})
        self.variables = {v.name: v for v in description.modelVariables}
        inputs, outputs = (_references(description, kind) for kind in ("input", "output"))
        self.inputs, self.outputs = (c_uint * len(inputs))(*inputs), (c_uint * len(outputs))(*outputs)
        self.given, self.received = (c_double * len(inputs))(), (c_double * len(outputs))()
        self.begin()

    def begin(self) -> None:
        self.time = 0.0
        self.fmu.setupExperiment(startTime=0.0)
        for name, value in self.settings.items():
            variable = self.variables[name]
            set_value = self.fmu.setReal if variable.type == "Real" else self.fmu.setInteger
            set_value([variable.valueReference], [value])
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def step(self, size: float, value: float) -> tuple[float, ...]:
        """Set all inputs to multiples of the value, step, and return the outputs."""
        for i in range(len(self.given)):
            self.given[i] = value * (i + 1)
        self.fmu.fmi2SetReal(self.fmu.component, self.inputs, len(self.given), self.given)
        self.fmu.fmi2DoStep(self.fmu.component, self.time, size, 1)
        self.fmu.fmi2GetReal(self.fmu.component, self.outputs, len(self.received), self.received)
        self.time += size
        return tuple(self.received)


def steady(folder: Path, steps: int) -> Memory:
    """The growth over this many steps of 1 ms."""
    instance = Stepped(folder)
    return _growth(steps, lambda k: instance.step(H, 0.01 * (k % 7)))


def varying(folder: Path, steps: int) -> Memory:
    """The growth over this many steps, of another size every fifty, one in fifty without finite inputs.

    pythonfmu keeps the text of each message and a plant has one for each such step, so there are not more of them.
    """
    instance, random = Stepped(folder), Random(1)
    sizes = [random.uniform(0.5 * H, 2.0 * H) for _ in range(steps // 50 + 1)]
    return _growth(steps, lambda k: instance.step(sizes[k // 50], nan if k % 50 == 3 else 0.01))


def _growth(steps: int, step) -> Memory:
    warm_up = min(steps // 10, WARM_UP)
    for k in range(warm_up):
        step(k)
    before = memory()
    for k in range(warm_up, steps):
        step(k)
    return memory() - before


def crowds(folder: Path, rounds: int) -> Memory:
    """The growth over rounds, after two, of 100 instances, freed in three orders; every tenth takes a step."""
    random = Random(1)
    before = None
    for k in range(rounds + 2):
        if k == 2:
            before = memory()
        instances = [Stepped(folder, f"i{i}") for i in range(100)]
        rows = {instance.step(H, 0.1) for instance in instances[::10]}
        assert len(rows) == 1, "equal instances give different outputs"
        order = ORDERS[k % len(ORDERS)]
        if order == "last in, first out":
            instances.reverse()
        elif order == "mixed":
            random.shuffle(instances)
        while instances:
            instances.pop(0).fmu.freeInstance()
    return memory() - before


def native(fmu: Path, steps: int, work: Path) -> int:
    """The growth (bytes) of the C host over this many steps."""
    run = unpack(fmu, work / "native", compile_host(work))
    inputs, outputs = (
        ",".join(map(str, _references(read_model_description(str(fmu)), kind))) or "-" for kind in ("input", "output")
    )
    command = [run.host, run.library, run.resources.as_uri(), run.guid]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={}) as host:

        def say(words: str) -> None:
            host.stdin.write(words + "\n")
            host.stdin.flush()
            assert not host.stdout.readline().startswith("log"), words

        for words in ("new fmu", "setup 0", "enter", "exit", f"run {WARM_UP} {H} {inputs} {outputs}"):
            say(words)
        before = resident(host.pid)
        say(f"run {steps} {H} {inputs} {outputs}")
        grown = resident(host.pid) - before
        host.stdin.close()
    return grown


RUNS = {"steady": steady, "varying": varying, "crowds": crowds}


def unpacked(fmu: Path, folder: Path) -> Path:
    """Unpack the FMU into the folder."""
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    return folder


def measure(fmu: Path, run: str, amount: int) -> Memory:
    """Unpack the FMU and have a fresh process measure."""
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        folder = unpacked(fmu, Path(work))
        command = [sys.executable, "-m", "tests.soak", "--inside", run, str(folder), str(amount)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"the process that ran {run} of {fmu.name} ended with {done.returncode}: {done.stderr}")
    return Memory(**json.loads(done.stdout))


def main() -> int:
    """Print the growth of each run."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--fmus", type=Path, help="folder with the shipped FMUs; built if it is not given")
    parser.add_argument("--inside", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        run, folder, amount = options.inside
        print(json.dumps(asdict(RUNS[run](Path(folder), int(amount)))))
        return 0
    largest = 0
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        for fmu in _fmus(options.fmus, Path(work)):
            for run, amount in (("steady", options.steps), ("varying", options.steps // 10), ("crowds", 10)):
                began = time.monotonic()
                grown = measure(fmu, run, amount)
                print(f"{fmu.stem:24}{run:10}{amount:9} {grown} in {time.monotonic() - began:.0f} s", flush=True)
                largest = max(largest, grown.resident) if run != "crowds" else largest
            with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as folder:
                grown = native(fmu, options.steps, Path(folder))
            print(f"{fmu.stem:24}{'native':10}{options.steps:9} resident={grown}", flush=True)
            largest = max(largest, grown)
    return int(largest >= LIMIT)


def _fmus(given: Path | None, work: Path) -> list[Path]:
    """Return a plant, an observer and the components."""
    if given:
        names = ("*Plant", "*Observer", *(record.name for record in records()))
        return sorted(path for name in names for path in given.glob(f"{name}.fmu"))
    return [*build(load_model("flexible_joint"), work), *build_components(work)]


if __name__ == "__main__":
    sys.exit(main())
