"""Malformed and odd bytes wherever a host hands text to an FMU: refused with one line, or taken; nothing ends the host.

python -m tests.attacks.texts --trials 3000 --seed 1 --fmus build/fmus
"""

from __future__ import annotations

import os
import shutil
import sys
import urllib.parse
from collections import Counter
from collections.abc import Callable
from ctypes import byref, c_char_p, c_int, c_size_t, c_void_p
from pathlib import Path
from random import Random

from ..fuzz.library import ERROR, OK, WARNING, Library
from .apart import main

# Surrogates, above U+10FFFF, overlong forms, sequences cut short, bytes that begin nothing; and some that are right.
SEQUENCES = (
    *(b"\xed\xa0\x80", b"\xed\xbf\xbf", b"\xf4\x90\x80\x80", b"\xf5\x80\x80\x80", b"\xe0\x80\xaf", b"\xf0\x80\x80\xaf"),
    *(b"\xc0\x80", b"\xc1\xbf", b"\xf0\x8f\xbf\xbf", b"\xc3", b"\xe2\x82", b"\xf0\x9f\x98", b"\x80", b"\xff", b"\xfe"),
    *(b"a", b" ", b"%", b"%n%s", b"\t", b"\x7f", b"\xc3\xa4", b"\xe2\x82\xac", b"\xf0\x9f\x98\x80"),
    *(b"\xf4\x8f\xbf\xbf", b"\xed\x9f\xbf", b"\xee\x80\x80", b"\xef\xbf\xbf", b"\xc2\x85", b"a" * 5000),
)
FOLDERS = 12
LONGEST_NATIVE = 1024  # bytes of a String variable of a native FMU, with the zero at its end


def drawn(random: Random) -> bytes:
    if random.random() < 0.2:
        return bytes(random.randrange(1, 256) for _ in range(random.randrange(6)))
    return b"".join(random.choice(SEQUENCES) for _ in range(random.randrange(1, 4)))


def decodes(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def attack(libraries: list[Library], trials: int, seed: int, note: Callable[[str], None]) -> Counter:
    """Draw texts for names, GUIDs, locations, log categories and String values."""
    random, counts = Random(seed), Counter()
    (source,) = (library for library in libraries if library.name == "DisturbanceSource")
    handle = source.new("texts", logging=1)
    kinds = (names, guids, locations, categories, strings)
    for k in range(trials):
        kind, text = kinds[k % len(kinds)], drawn(random)
        note(f"{kind.__name__} {text!r}")
        library = source if kind in (categories, strings) else random.choice(libraries)
        for one in libraries:
            one.said.clear()
        counts[f"{kind.__name__}: {kind(library, handle, text)}"] += 1
    for k in range(FOLDERS):
        sequence = SEQUENCES[k]
        note(f"folder {sequence!r}")
        counts[f"folders: {folders(random.choice(libraries), sequence, k)}"] += 1
    source.FreeInstance(handle)
    return counts


def made(library: Library, name: bytes, guid: bytes, location: bytes) -> bool:
    """Instantiate and free again; what is refused is one line, what is taken none."""
    library.said.clear()
    handle = library.Instantiate(
        c_char_p(name), c_int(1), c_char_p(guid), c_char_p(location), byref(library.callbacks), c_int(0), c_int(1)
    )
    assert len(library.said) == int(not handle), library.said
    if handle:
        library.FreeInstance(c_void_p(handle))
    return bool(handle)


def names(library: Library, _handle: c_void_p, text: bytes) -> str:
    expected = bool(text) and decodes(text)
    assert made(library, text, library.guid.encode(), library.resources.encode()) == expected
    return "taken" if expected else "refused"


def guids(library: Library, _handle: c_void_p, text: bytes) -> str:
    assert not made(library, b"texts", text, library.resources.encode())
    return "refused"


def locations(library: Library, _handle: c_void_p, text: bytes) -> str:
    if library.is_native:  # which needs no files, and so no location
        assert made(library, b"texts", library.guid.encode(), text)
        return "not read"
    percent = "".join(f"%{byte:02x}" for byte in text).encode()
    assert not made(library, b"texts", library.guid.encode(), library.resources.encode() + b"/" + percent + b"%00/..")
    assert len(library.said) == 1
    library.said.clear()
    assert not made(library, b"texts", library.guid.encode(), text)
    return "refused"


def categories(source: Library, handle: c_void_p, text: bytes) -> str:
    assert source.SetDebugLogging(handle, c_int(1), c_size_t(1), (c_char_p * 1)(text)) == WARNING
    assert source.SetDebugLogging(handle, c_int(1), c_size_t(0), None) == OK
    return "unknown"


def strings(source: Library, handle: c_void_p, text: bytes) -> str:
    (reference,) = (v.reference for v in source.variables if v.name == "disturbance.profile")
    before = source.get(handle, [reference], "String")
    status = source.set(handle, [reference], [text], "String")
    fits = not source.is_native or len(text) < LONGEST_NATIVE
    assert status == (OK if decodes(text) and fits else ERROR), status
    assert source.get(handle, [reference], "String") == ((OK, (text,)) if status == OK else before)
    return "taken" if status == OK else "refused"


def folders(library: Library, sequence: bytes, k: int) -> str:
    """The FMU runs from a folder with this in its name."""
    here = os.fsencode(Path(library.folder).parent)
    folder = here + b"/" + str(k).encode() + sequence
    shutil.copytree(os.fsencode(library.folder), folder)
    location = b"file://" + urllib.parse.quote_from_bytes(folder + b"/resources").encode()
    assert made(library, b"texts", library.guid.encode(), location)
    return "taken"


if __name__ == "__main__":
    sys.exit(main("tests.attacks.texts", __doc__.splitlines()[0], attack, 3000))
