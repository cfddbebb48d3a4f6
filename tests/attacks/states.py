"""FMU states with wrong contents and the right checksums: refused and nothing changed, or taken and honest afterwards.

python -m tests.attacks.states --trials 5000 --seed 1 --fmus build/fmus
"""

from __future__ import annotations

import base64
import hashlib
import json
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from ctypes import byref, c_size_t, c_void_p, create_string_buffer
from math import inf, isinf, nan
from random import Random

from tests.helpers.component_settings import moved

from ..fuzz.library import DISCARD, ERROR, OK, WARNING, Library
from .apart import main

# What ndob_fmu/fmu/shell/state.c writes before the slave's bytes: magic, FMU, size, hash, mode, experiment, time.
HEAD = struct.Struct("<8s3Q2Id")
INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED = 1, 2, 4, 8
H = 1e-3
DEEP = "nested"  # in place of this come brackets in brackets
LONGEST = 20.0  # s of processor time for what follows a state that was taken
NUMBERS = (0.0, -0.0, 1.0, -1.0, 0.5, 1e-300, 5e-324, 1e12, -1e12, 1e300, -1e300, 1.7e308, nan, inf, -inf)
INTEGERS = (0, 1, -1, 2, 7, 2**31 - 1, 2**31, -(2**31) - 1, 2**63, 10**20, 10**400, -(10**400))
TEXTS = (
    "",
    "1.0",
    "nan",
    "\ud800",
    "\udfff\ud800",
    "a\0b",
    "%n%s%d",
    "ä€😀",
    "x" * 20_000,
    "two\nlines",
    "/dev/zero",
    "/",
)
ARRAYS = (
    *(["<f8", [0], ""], ["<f8", [1], base64.b64encode(struct.pack("<d", nan)).decode()], ["<f8", [-1], "AAAAAAAAAAA="]),
    *(
        ["<f8", [10**400], ""],
        ["|O", [1], ""],
        ["<f8", [2], "AA"],
        ["<f8", 1, "AAAAAAAAAAA="],
        ["<f8", [1.0], "AAAAAAAAAAA="],
    ),
    *(
        ["<i8", [1], "AAAAAAAAAAA="],
        ["|b1", [1], "Bw=="],
        ["<f8", [], "AAAAAAAAAAA="],
        [[], [], []],
        ["<f8", [1], "AAAA*AAAAAA="],
    ),
)


# -- real states, and one place of one changed


def situations(library: Library) -> Iterator[tuple[int, c_void_p]]:
    """Yield modes and instances of an FMU as hosts have them."""
    choices: list[dict[str, float]] = [{}]
    if library.name.endswith("Observer"):
        choices = [{"method": 1, "pi_end": 1e6}, *({"method": 2, "disturbance_order": order} for order in range(4))]
    elif library.name == "DisturbanceSource":
        choices = [{"disturbance.kind": kind} for kind in (1, 3, 6)]
    elif not library.name.endswith(("Plant", "Controller")):
        choices = [{}, moved(library.variables)]
    for choice in choices:
        for mode in (INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED):
            yield mode, led(library, mode, choice)


def led(library: Library, mode: int, choice: dict[str, float]) -> c_void_p:
    handle = library.new("state", logging=1)
    for variable in library.variables:
        if variable.name in choice:
            assert library.set(handle, [variable.reference], [choice[variable.name]], variable.type) == OK
    if mode >= INITIALIZATION:
        assert library.setup(handle, 0.5, 50.0) == OK
        assert library.EnterInitializationMode(handle) == OK
        library.get(handle, library.references("Real", "output"))
    if mode >= STEPPING:
        assert library.ExitInitializationMode(handle) == OK
        for k in range(4):
            assert stepped(library, handle, 0.5 + k * H)[0] == OK
    if mode == TERMINATED:
        assert library.Terminate(handle) == OK
    return handle


def places(tree, path=()) -> Iterator[tuple]:
    yield path
    for key, value in enumerate(tree) if isinstance(tree, list) else tree.items() if isinstance(tree, dict) else ():
        yield from places(value, (*path, key))


def at(tree, path: tuple):
    for key in path:
        tree = tree[key]
    return tree


def other(value, random: Random):
    """Return something else in place of a value."""
    kind = random.randrange(10)
    if kind == 0:
        return random.choice(TEXTS)
    if kind == 1:
        return random.choice(INTEGERS)
    if kind == 2:
        return random.choice([True, False, None, [], {}, [value], {"tuple": [value]}, {"state": ["Snapshot"]}])
    if kind == 3:
        return {"array": random.choice(ARRAYS)}
    if kind == 4:
        return DEEP
    if isinstance(value, list) and value:
        changed, i, j = list(value), random.randrange(len(value)), random.randrange(len(value))
        if kind == 5:
            del changed[i]
        elif kind == 6:
            changed.insert(i, value[j])
        else:
            changed[i], changed[j] = value[j], value[i]
        return changed
    if isinstance(value, dict):
        return (
            {**value, "more": 1}
            if kind < 7
            else {random.choice(["state", "tuple", "array", "map", "x"]): v for v in value.values()}
        )
    if isinstance(value, float) and kind > 6:
        return value * random.choice([0.5, 1.01, 3.0, -1.0]) + random.choice([0.0, 1e-3, 1.0])
    if isinstance(value, bool):
        return not value
    if isinstance(value, int) and kind > 6:
        return value + random.choice([-1, 1, 100])
    return random.choice(NUMBERS)


def written(tree, random: Random) -> tuple[bytes, bool]:
    """Return the bytes of JSON, and whether they are in a form that the slave never writes."""
    text = usual = json.dumps(tree, separators=(",", ":"))
    begin, end = random.choice([('{"tuple":[', "]}"), ("[", "]"), ('{"x":', "}")])
    depth = random.choice([2, 100, 300, 480, 990, 20_000])
    text = text.replace(f'"{DEEP}"', begin * depth + "0" + end * depth)
    if random.random() < 0.05:
        text = random.choice([
            " " + text, text.replace(",", ", ", 1), text.replace("{", '{"state":1,', 1), text[:-1], text + "0",
            text.replace("1", "1e400", 1), "[" * 100_000, text.replace("[", "[" * 300, 1), "1" * 5000, "",
        ])  # fmt: skip
    coding = random.choice(["utf-16", "utf-8-sig"]) if random.random() < 0.02 else "utf-8"
    content = text.encode(coding, "surrogatepass")
    return content, content != usual.encode()


def forged(head: tuple, mode: int, last_time: float, content: bytes) -> bytes:
    """Return the bytes of a state with the checksums of front and slave."""
    inner = hashlib.sha256(content).digest() + content
    progress = HEAD.pack(head[0], head[1], 0, 0, mode, head[5], last_time)[32:]
    check = 0xCBF29CE484222325
    for byte in progress + inner:
        check = (check ^ byte) * 0x100000001B3 & 0xFFFFFFFFFFFFFFFF
    return HEAD.pack(head[0], head[1], len(inner), check, mode, head[5], last_time) + inner


# -- through the FMU


def bytes_of(library: Library, handle: c_void_p) -> bytes:
    state, size = c_void_p(), c_size_t()
    assert library.GetFMUstate(handle, byref(state)) == OK
    assert library.SerializedFMUstateSize(handle, state, byref(size)) == OK
    buffer = create_string_buffer(size.value)
    assert library.SerializeFMUstate(handle, state, buffer, size) == OK
    assert library.FreeFMUstate(handle, byref(state)) == OK
    return buffer.raw


def taken(library: Library, handle: c_void_p, data: bytes) -> bool:
    """Give the bytes to the FMU; what is refused is one line with Error."""
    said, state = len(library.said), c_void_p()
    status = library.DeSerializeFMUstate(handle, data, c_size_t(len(data)), byref(state))
    if status == OK:
        status = library.SetFMUstate(handle, state)
        assert library.FreeFMUstate(handle, byref(state)) == OK
    messages = library.said[said:]
    assert status in (OK, ERROR), status
    assert [one[1] for one in messages] == [ERROR] * (status == ERROR), messages
    assert all(len(text) <= 310 and text.isprintable() for *_, text in messages), messages
    return bool(status == OK)


def stepped(library: Library, handle: c_void_p, t: float) -> tuple[int, tuple]:
    inputs = library.references("Real", "input")
    assert library.set(handle, inputs, [0.1] * len(inputs)) == OK
    status = library.step(handle, t, H)
    return status, library.get(handle, library.references("Real", "output"))[1]


def used(library: Library, handle: c_void_p, mode: int, stop: float | None, t: float) -> str:
    """Go on as a host would from a state that was taken, at time t; return how that went."""
    if mode == TERMINATED:
        assert library.get(handle, library.references("Real", "output"))[0] in (OK, ERROR)
        return "terminated"
    if mode == INSTANTIATED:
        t, stop = 0.0, None
        assert library.setup(handle, t) == OK
        assert library.EnterInitializationMode(handle) == OK
    if mode < STEPPING and library.ExitInitializationMode(handle) != OK:
        return "parameters that cannot be used"
    for _ in range(3):
        status, outputs = stepped(library, handle, t)
        late = stop is not None and t + H > stop
        assert status in ((OK, WARNING, DISCARD, ERROR) if late else (OK, WARNING, DISCARD)), status
        if status >= DISCARD:
            return "no step"
        assert not any(map(isinf, outputs)), outputs
        t += H
    return "steps"


def attack(libraries: list[Library], trials: int, seed: int, note: Callable[[str], None]) -> Counter:
    """Spoil one place of a real state in each trial, field by field."""
    random, counts = Random(seed), Counter()
    bases = [(library, *situation) for library in libraries for situation in situations(library)]
    order: list[tuple] = []
    for k in range(trials):
        if not order:  # every place of every state once before any is tried again, and a state's own fields five times
            for library, mode, handle in bases:
                data = bytes_of(library, handle)
                found = list(places(json.loads(data[HEAD.size + 32 :])))
                order += [(library, mode, handle, data, path) for path in found + [p for p in found if len(p) < 3] * 4]
            random.shuffle(order)
        library, mode, handle, data, path = order.pop()
        counts[
            f"{library.name}: {trial(library, mode, handle, data, path, random, lambda w, k=k: note(f'{k} {w}'))}"
        ] += 1
    return counts


def trial(library: Library, mode: int, handle: c_void_p, data: bytes, path: tuple, random: Random, note) -> str:
    """Change what is at one place of a state that the instance is in, give it back, and return what came of it."""
    head, tree = HEAD.unpack(data[: HEAD.size]), json.loads(data[HEAD.size + 32 :])
    old = at(tree, path)
    value = other(old, random)
    if path:
        at(tree, path[:-1])[path[-1]] = value
    else:
        tree = value
    last_time = head[6]
    if random.random() < 0.1:
        mode, last_time = random.choice([1, 2, 4, 8]), random.choice([last_time, 0.0, 1e300])
    content, odd = written(tree, random)
    note(f"{library.name} mode {mode} {path} {value!r:.300}")
    library.said.clear()
    before = time.process_time()
    if not taken(library, handle, forged(head, mode, last_time, content)):
        assert bytes_of(library, handle) == data, "a refused state has changed the instance"
        return "refused"
    assert not odd, "bytes that no slave writes are taken"
    assert type(value) is type(old) or None in (value, old), "a value of another type is taken"
    how = used(library, handle, mode, *tree["state"][8:10])
    passed = time.process_time() - before
    assert passed < LONGEST, f"{passed:.1f} s"
    assert taken(library, handle, data)
    assert bytes_of(library, handle) == data, "a real state does not come back after a crafted one"
    return f"taken, {how}"


if __name__ == "__main__":
    sys.exit(main("tests.attacks.states", __doc__.splitlines()[0], attack, 5000))
