"""States of native FMUs with wrong contents and right checksums: refused and nothing changed, or taken and harmless.

python -m tests.attacks.native_states --trials 5000 --seed 1 --fmus build/native/fmus
"""

from __future__ import annotations

import struct
import sys
from collections import Counter
from collections.abc import Callable
from ctypes import c_void_p
from random import Random

from ..fuzz.library import Library
from .apart import main
from .states import INTEGERS, NUMBERS, bytes_of, situations, taken, used

# What ndob_fmu/native/shell/states.c writes before values, parameters and state: magic, FMU, size, hash;
# and what `Progress` in shell.h holds: start, stop, now, step size, last time; mode, and five flags.
HEAD, PROGRESS = struct.Struct("<8s3Q"), struct.Struct("<5d6I")
_NOW, _STOP, _MODE, _HAS_STOP = 2, 1, 5, 7
WORDS = (0, 1, 2, 3, 4, 8, 0xFFFFFFFF, 0x7FFFFFFF, 0x80000000)


def forged(data: bytes, contents: bytes) -> bytes:
    """Return a state with other contents and the checksum of these."""
    check = 0xCBF29CE484222325
    for byte in contents:
        check = (check ^ byte) * 0x100000001B3 & 0xFFFFFFFFFFFFFFFF
    magic, token, _, _ = HEAD.unpack(data[: HEAD.size])
    return HEAD.pack(magic, token, len(contents), check) + contents


def spoilt(contents: bytes, random: Random) -> tuple[str, bytes]:
    """Return contents that differ in one place or in a few, or in length, and what was done in words."""
    spoilt, words = bytearray(contents), []
    for _ in range(random.choice([1, 1, 1, 2, 5, 40])):
        kind = random.randrange(5)
        place = random.randrange(len(contents) // 8) * 8
        if random.random() < 0.2:
            place = random.randrange(PROGRESS.size // 8) * 8
        (old,) = struct.unpack_from("<d", contents, place)
        if kind == 0:
            new = struct.pack("<d", random.choice([*NUMBERS, *(float(i) for i in INTEGERS if abs(i) < 2**64)]))
        elif kind == 1:
            new = struct.pack("<d", old * random.choice([0.5, 1.01, 3.0, -1.0]) + random.choice([0.0, 1e-3, 1.0]))
        elif kind == 2:
            new = struct.pack("<2I", random.choice(WORDS), random.choice(WORDS))
        elif kind == 3:
            new = random.randbytes(8)
        else:
            other = random.randrange(len(contents) // 8) * 8
            new = contents[other : other + 8]
        spoilt[place : place + 8] = new
        words.append(f"{place}: {new.hex()}")
    if random.random() < 0.2:
        more = random.choice([-len(spoilt), -PROGRESS.size, -1000, -8, -1, 1, 8, 1000, 10**6])
        spoilt = spoilt[:more] if more < 0 else spoilt + random.choice([bytes(more), random.randbytes(more)])
        words.append(f"{more} bytes more")
    return " ".join(words), bytes(spoilt)


def attack(libraries: list[Library], trials: int, seed: int, note: Callable[[str], None]) -> Counter:
    """Spoil a real state of some FMU in each trial, and go on from it if it is taken."""
    random, counts = Random(seed), Counter()
    cases = [(library, handle) for library in libraries for _, handle in situations(library)]
    for k in range(trials):
        library, handle = random.choice(cases)
        data = bytes_of(library, handle)
        words, contents = spoilt(data[HEAD.size :], random)
        note(f"{k} {library.name} {words}")
        counts[f"{library.name}: {trial(library, handle, data, contents)}"] += 1
    return counts


def trial(library: Library, handle: c_void_p, data: bytes, contents: bytes) -> str:
    """Give the contents to the instance, whose state the data are, and return what happened."""
    library.said.clear()
    if not taken(library, handle, forged(data, contents)):
        assert bytes_of(library, handle) == data, "a refused state has changed the instance"
        return "refused"
    progress = PROGRESS.unpack_from(contents)  # no state is shorter
    stop = progress[_STOP] if progress[_HAS_STOP] else None
    how = used(library, handle, progress[_MODE], stop, progress[_NOW])
    assert taken(library, handle, data)
    assert bytes_of(library, handle) == data, "a real state does not come back after a crafted one"
    return f"taken, {how}"


if __name__ == "__main__":
    sys.exit(main("tests.attacks.native_states", __doc__.splitlines()[0], attack, 5000))
