"""Random calls of FMI 3.0 on native FMUs, as a broken importer makes them.

python -m tests.attacks.fmi3 [--calls N] [--seed S] --fmus FOLDER

Handles are good, freed or invented; references, counts, numbers, texts, states and bytes are good or not. Ends with 1
if a status is not OK, Warning, Discard or Error, if an error says nothing, if the bytes of a state are refused, if a
call that was refused has changed a value, or if a fresh instance no longer does what the first one did.
"""

from __future__ import annotations

import argparse
import ctypes
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
import zipfile
from collections import Counter
from ctypes import byref, c_bool, c_char_p, c_double, c_int32, c_int64, c_size_t, c_uint32, c_void_p
from pathlib import Path
from random import Random

OK, WARNING, DISCARD, ERROR = range(4)
TYPES = {"Float64": c_double, "Int32": c_int32, "Int64": c_int64, "Boolean": c_bool, "String": c_char_p}
_LOG = ctypes.CFUNCTYPE(None, c_void_p, ctypes.c_int, c_char_p, c_char_p)
# Each value of a walk's choice costs time; so many instances show what more would.
_MOST_INSTANCES = 4
_WITNESS_EVERY = 500
_NUMBERS = (0.0, -1.0, 1.0, 1e-300, 1e300, 5e-324, float("inf"), float("-inf"), float("nan"), 2.0**31, 2.0**63)
_INTEGERS = (0, 1, 2, 3, -1, 2**31 - 1, -(2**31))
_TEXTS = (b"", b"a", b"\xff\xfe", "ü".encode(), b"x" * 5000, None)


class Library:
    """An unpacked FMU of FMI 3.0; `said` collects the messages."""

    def __init__(self, folder: Path) -> None:
        root = ElementTree.parse(folder / "modelDescription.xml").getroot()
        self.token = root.get("instantiationToken").encode()
        name = root.find("CoSimulation").get("modelIdentifier")
        found = root.find("ModelVariables")
        self.references = {kind: [int(one.get("valueReference")) for one in found.findall(kind)] for kind in TYPES}
        self.references["Int64"] += [int(one.get("valueReference")) for one in found.findall("Enumeration")]
        self.functions = ctypes.CDLL(str(folder / "binaries" / "x86_64-linux" / f"{name}.so"))
        self.functions.fmi3InstantiateCoSimulation.restype = c_void_p
        self.functions.fmi3FreeInstance.restype = None
        self.said = 0
        self._log = _LOG(self._receive)  # ctypes calls it as long as somebody holds it

    def _receive(self, _environment, _status, _category, _message) -> None:
        self.said += 1

    def call(self, function: str, *arguments):
        """Return the status of the FMI function without its prefix."""
        return getattr(self.functions, f"fmi3{function}")(*arguments)

    def new(self, *, token: bytes | None = None, name: bytes | None = b"one", event_mode: bool = False) -> int | None:
        """Instantiate with logging."""
        given = (c_char_p(name), c_char_p(self.token if token is None else token), c_char_p(b""), c_bool(False))
        modes = (c_bool(True), c_bool(event_mode), c_bool(False), None, c_size_t(0), None)
        return self.call("InstantiateCoSimulation", *given, *modes, self._log, None)

    def get(self, handle: c_void_p, kind: str, references, count: int | None = None):
        """Return the status and the values."""
        values = (TYPES[kind] * max(len(references), 1))()
        given = (c_uint32 * len(references))(*references)
        size = len(references) if count is None else count
        status = self.call(f"Get{kind}", handle, given, c_size_t(len(references)), values, c_size_t(size))
        return status, list(values)[: len(references)]

    def begin(self, handle: c_void_p, start: float = 0.0) -> int:
        """Go to step mode."""
        end = (c_bool(False), c_double(0.0))
        status = self.call("EnterInitializationMode", handle, c_bool(False), c_double(0.0), c_double(start), *end)
        return status or self.call("ExitInitializationMode", handle)

    def step(self, handle: c_void_p, time: float, size: float, *, silent: bool = False) -> int:
        """Make a step; `silent`: without places for what the FMU answers."""
        answers = [c_bool(), c_bool(), c_bool(), c_double()]
        given = [None] * 4 if silent else [byref(one) for one in answers]
        return self.call("DoStep", handle, c_double(time), c_double(size), c_bool(True), *given)

    def witness(self) -> list[object]:
        """Return what a fresh instance does in ten steps."""
        handle = c_void_p(self.new())
        assert self.begin(handle) == OK
        shown: list[object] = [self.step(handle, 1e-3 * k, 1e-3) for k in range(10)]
        for kind in ("Float64", "Int32", "Boolean"):
            shown += [repr(value) for value in self.get(handle, kind, self.references[kind])[1]]
        self.call("FreeInstance", handle)
        return shown


class Walk:
    """Calls at random on a library."""

    def __init__(self, library: Library, random: Random) -> None:
        self.library, self.random = library, random
        self.alive: list[int] = []
        self.freed: list[int] = []
        self.time: dict[int, float] = {}
        self.states: list[tuple[int, int]] = []  # of an instance
        self.gone: list[int] = []
        self.counts: Counter[str] = Counter()
        self.fault = ""  # of the present call
        self.actions = {
            "instantiate": 2, "free": 1, "initialise": 6, "step": 40, "get": 10, "set": 20, "reset": 1, "terminate": 1,
            "state": 10, "bytes": 6, "logging": 1, "unsupported": 2,
        }  # fmt: skip

    def handle(self) -> tuple[c_void_p, bool]:
        """Return a handle and whether it is that of an instance."""
        if self.alive and self.random.random() < 0.95:
            return c_void_p(self.random.choice(self.alive)), True
        return c_void_p(self.random.choice([*self.freed, 0, 1, 4096, 2**40 + 3])), False

    def act(self) -> str:
        """Make one call; return what is wrong, or nothing."""
        name = self.random.choices(list(self.actions), list(self.actions.values()))[0]
        if not self.alive:
            name = "instantiate"
        before = self.library.said
        (handle, known), status, self.fault = self.handle(), None, ""
        status = getattr(self, name)(handle)
        self.counts[f"{name} {status}"] += 1
        if status is None:
            return ""
        if self.fault:
            return f"{name}: {self.fault}"
        if status not in (OK, WARNING, DISCARD, ERROR):
            return f"{name}: status {status}"
        if not known and status != ERROR:
            return f"{name}: status {status} for no instance"
        silent = known and status == ERROR and self.library.said == before
        return f"{name}: an error without a message" if silent else ""

    def instantiate(self, _handle: c_void_p) -> None:
        if len(self.alive) >= _MOST_INSTANCES:
            return
        odd = self.random.random() < 0.2
        new = self.library.new(token=b"{another}" if odd else None, name=self.random.choice(_TEXTS) if odd else b"one")
        if new:
            self.alive.append(new)
            self.time[new] = 0.0

    def free(self, handle: c_void_p) -> None:
        self.library.call("FreeInstance", handle)
        if handle.value in self.alive:
            self.alive.remove(handle.value)
            self.freed.append(handle.value)
            self.gone += [state for owner, state in self.states if owner == handle.value]
            self.states = [one for one in self.states if one[0] != handle.value]

    def initialise(self, handle: c_void_p) -> int:
        start = self.random.choice([0.0, 0.0, 1.0, *_NUMBERS])
        status = self.library.begin(handle, start)
        if status == OK:
            self.time[handle.value] = start
        return status

    def step(self, handle: c_void_p) -> int:
        odd = self.random.random() < 0.1
        size = self.random.choice(_NUMBERS) if odd else 1e-3
        time = self.random.choice(_NUMBERS) if self.random.random() < 0.05 else self.time.get(handle.value, 0.0)
        status = self.library.step(handle, time, size, silent=self.random.random() < 0.1)
        if status in (OK, WARNING) and handle.value in self.time:
            self.time[handle.value] = time + size
        return status

    def some(self, kind: str) -> list[int]:
        good = self.library.references[kind]
        others = [0, 1, 10**6, 2**32 - 1]
        return [
            self.random.choice(good if good and self.random.random() < 0.95 else others)
            for _ in range(self.random.choice([0, 1, 1, 2, 5]))
        ]

    def get(self, handle: c_void_p) -> int:
        kind = self.random.choice(list(TYPES))
        references = self.some(kind)
        odd = self.random.random() < 0.05
        return self.library.get(handle, kind, references, len(references) + 1 if odd else None)[0]

    def set(self, handle: c_void_p) -> int:
        kind = self.random.choice(list(TYPES))
        references = self.some(kind)
        choices = {"Float64": (*_NUMBERS, 0.1), "Boolean": (True, False), "String": _TEXTS}.get(kind, _INTEGERS)
        values = (TYPES[kind] * max(len(references), 1))(*(self.random.choice(choices) for _ in references))
        given = (c_uint32 * len(references))(*references)
        count = len(references) + (1 if self.random.random() < 0.05 else 0)
        return self.library.call(f"Set{kind}", handle, given, c_size_t(len(references)), values, c_size_t(count))

    def reset(self, handle: c_void_p) -> int:
        return self.library.call("Reset", handle)

    def terminate(self, handle: c_void_p) -> int:
        return self.library.call("Terminate", handle)

    def state(self, handle: c_void_p) -> int:
        what = self.random.choice(["Get", "Set", "Free"])
        invented = [0, 1, 4096, *self.gone]
        if what == "Get":
            place = c_void_p(0 if self.random.random() < 0.9 else self.random.choice(invented))
            status = self.library.call("GetFMUState", handle, byref(place))
            if status == OK:
                self.states.append((handle.value, place.value))
            return status
        good = self.states and self.random.random() < 0.8
        owner, state = self.random.choice(self.states) if good else (0, self.random.choice(invented))
        if what == "Set":
            return self.library.call("SetFMUState", handle, c_void_p(state))
        place = c_void_p(state)
        status = self.library.call("FreeFMUState", handle, byref(place))
        if status == OK and good:
            self.states.remove((owner, state))
            self.gone.append(state)
        return status

    def bytes(self, handle: c_void_p) -> int:
        state = c_void_p(self.random.choice(self.states)[1] if self.states else 0)
        size = c_size_t()
        status = self.library.call("SerializedFMUStateSize", handle, state, byref(size))
        if status != OK:
            return status
        block = (ctypes.c_ubyte * size.value)()
        status = self.library.call("SerializeFMUState", handle, state, block, size)
        if status != OK:
            return status
        spoilt = self.random.random() < 0.5
        if spoilt:
            block[self.random.randrange(size.value)] ^= 1 << self.random.randrange(8)
        length = size.value if self.random.random() < 0.8 else self.random.randrange(size.value)
        place = c_void_p()
        status = self.library.call("DeserializeFMUState", handle, block, c_size_t(length), byref(place))
        if status == OK:
            self.states.append((handle.value, place.value))
        elif not spoilt and length == size.value:
            self.fault = "the bytes of a state are refused"
        return status

    def logging(self, handle: c_void_p) -> int:
        names = (c_char_p * 1)(self.random.choice([b"logStatusError", b"nothing", b""]))
        return self.library.call("SetDebugLogging", handle, c_bool(True), c_size_t(self.random.randrange(2)), names)

    def unsupported(self, handle: c_void_p) -> int:
        return self.library.call(
            self.random.choice(["EnterEventMode", "EnterStepMode", "EnterConfigurationMode"]), handle
        )


def attack(path: Path, calls: int, seed: int) -> tuple[Counter[str], list[str]]:
    """Return how often each call had each status, and what was wrong."""
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work, zipfile.ZipFile(path) as archive:
        archive.extractall(work)
        library = Library(Path(work))
        first, walk, faults = library.witness(), Walk(library, Random(f"{path.stem} {seed}")), []
        for k in range(calls):
            if fault := walk.act():
                faults.append(f"{path.stem}, call {k}: {fault}")
            if k % _WITNESS_EVERY == 0 and library.witness() != first:
                faults.append(f"{path.stem}, call {k}: a fresh instance does something else")
        for handle in walk.alive:
            library.call("FreeInstance", c_void_p(handle))
    return walk.counts, faults


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.attacks.fmi3", description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fmus", type=Path, required=True)
    options = parser.parse_args()
    faults = []
    for path in sorted(options.fmus.glob("*.fmu")):
        print(path.name, flush=True)
        counts, found = attack(path, options.calls, options.seed)
        faults += found
        print(", ".join(f"{count} {name}" for name, count in sorted(counts.items())))
    for fault in faults[:20]:
        print(fault)
    print(f"{options.calls} calls an FMU, seed {options.seed}: {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
