"""Damaged and malicious archives: each is refused in one line, or read as what it was, in bounded memory and time.

An attack changes an FMU, which is then read and run alone or inside a package, or the package itself. The expected
verdict of each attack is ``accept``, ``refuse``, or ``either`` for random damage, which may hit what nobody reads: then
the result must be that of the sound archive.
"""

from __future__ import annotations

import io
import os
import resource
import struct
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random
from unittest import mock

from pythonfmu.builder import FmuBuilder

from ndob_fmu.cosim import System, check_ssp, simulate
from ndob_fmu.errors import MESSAGE_LIMIT, NdobError
from ndob_fmu.packages import write_ssp

from .options import closing_line, read_options

_SLAVE = Path(__file__).parents[1] / "helpers" / "coupling_slaves" / "gain.py"
_MOST_MEMORY = 3 * 2**30  # bytes of address space beyond what the process has at the start
_MOST_SECONDS = 10.0  # of the processors for one archive
_DESCRIPTION, _SYSTEM = "modelDescription.xml", "SystemStructure.ssd"
_BOMB = '<!DOCTYPE a [<!ENTITY b "bbbbbbbbbb">' + "".join(f'<!ENTITY b{k} "{"&b;" * 10}">' for k in range(9)) + "]>"

Entries = list[tuple[zipfile.ZipInfo, bytes]]
Attack = Callable[[Random, bytes], bytes]


def entries_of(data: bytes) -> Entries:
    with zipfile.ZipFile(io.BytesIO(data)) as source:
        return [(entry, source.read(entry)) for entry in source.infolist()]


def packed(entries: Entries) -> bytes:
    target = io.BytesIO()
    with mock.patch("warnings.warn"), zipfile.ZipFile(target, "w") as new:  # which warns of a name that is there twice
        for entry, content in entries:
            new.writestr(entry, content, entry.compress_type)
    return target.getvalue()


def new_entry(name: str, method: int = zipfile.ZIP_DEFLATED) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)
    entry.compress_type = method
    return entry


def with_entry(data: bytes, name: str, content: bytes = b"x", method: int = zipfile.ZIP_DEFLATED) -> bytes:
    return packed([*entries_of(data), (new_entry(name, method), content)])


def patched(data: bytes, name: str, local: int, central: int, form: str, value: int) -> bytes:
    """Return the archive with a field of both headers of an entry overwritten; local, central: where the field lies."""
    changed = bytearray(data)
    for signature, fixed, length_at, field in ((b"PK\3\4", 30, 26, local), (b"PK\1\2", 46, 28, central)):
        at = -1
        while (at := changed.find(signature, at + 1)) >= 0:
            (length,) = struct.unpack_from("<H", changed, at + length_at)
            if changed[at + fixed : at + fixed + length] == name.encode():
                struct.pack_into(form, changed, at + field, value)
    return bytes(changed)


def root_file(data: bytes) -> str:
    names = {entry.filename for entry, _ in entries_of(data)}
    return _SYSTEM if _SYSTEM in names else _DESCRIPTION


def with_root(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    root = root_file(data)
    return packed([(e, change(content) if e.filename == root else content) for e, content in entries_of(data)])


def doctype(rng: Random, data: bytes) -> bytes:
    def change(text: bytes) -> bytes:
        head, mark, rest = text.decode("utf-8").partition("?>")
        attack = _BOMB if rng.random() < 0.5 else f'<!DOCTYPE a SYSTEM "{rng.choice(["file:///etc/passwd", "a.dtd"])}">'
        if rng.random() < 0.5:
            return f"{head}{mark}{attack}{rest}".encode()
        return f'<?xml version="1.0" encoding="UTF-16"?>{attack}{rest}'.encode("utf-16")

    return with_root(data, change)


def link(rng: Random, data: bytes) -> bytes:
    entry = new_entry("resources/link")
    entry.external_attr = rng.choice([0o120777, 0o020666, 0o010666]) << 16  # a link, a device, a pipe
    return packed([*entries_of(data), (entry, b"/etc/passwd")])


def outside(rng: Random, data: bytes) -> bytes:
    return with_entry(data, rng.choice(["/etc/x", "../x", "a/../../x", "C:/x", "C:x", "..\\x", "\\\\host\\x"]))


def twice(rng: Random, data: bytes) -> bytes:
    return with_entry(data, rng.choice([root_file(data), f"./{root_file(data)}", f"{root_file(data)}/x"]))


def encrypted(rng: Random, data: bytes) -> bytes:
    return patched(data, root_file(data), 6, 8, "<H", 1)


def method(rng: Random, data: bytes) -> bytes:
    if rng.random() < 0.5:
        return with_entry(data, "resources/x", bytes(1000), rng.choice([zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]))
    return patched(data, root_file(data), 8, 10, "<H", rng.choice([1, 6, 9, 93, 97, 98, 99]))


def huge(rng: Random, data: bytes) -> bytes:
    """Declare more than an archive may unpack to, in two entries or in many."""
    count, size = rng.choice([(2, 2**32 - 2), (6, 2**30), (5000, 2**20)])
    names = [f"resources/{k}" for k in range(count)]
    data = packed([*entries_of(data), *((new_entry(name), b"x") for name in names)])
    for name in names[:6]:
        data = patched(data, name, 22, 24, "<I", max(size, 2**30))
    return data


def many(rng: Random, data: bytes) -> bytes:
    names = (new_entry(f"resources/{k}", zipfile.ZIP_STORED) for k in range(20_001))
    return packed([*entries_of(data), *((entry, b"") for entry in names)])


def long_contents(rng: Random, data: bytes) -> bytes:
    """Declare a table of contents that is larger than the memory."""
    changed = bytearray(data)
    at = changed.rfind(b"PK\5\6")
    struct.pack_into("<I", changed, at + 12, rng.choice([2**31, 2**32 - 2]))
    return bytes(changed) if rng.random() < 0.5 else bytes(changed[:at]) + bytes(20 * 2**20) + bytes(changed[at:])


def long_xml(rng: Random, data: bytes) -> bytes:
    return with_root(data, lambda text: text + b" " * (65 * 2**20))


def deep_xml(rng: Random, data: bytes) -> bytes:
    depth = rng.choice([10_000, 1_000_000])
    return with_root(data, lambda text: b"<a>" * depth + b"</a>" * depth)


def odd_name(rng: Random, data: bytes) -> bytes:
    if rng.random() < 0.3:
        return with_entry(data, "r" * 300)
    name = "resources/abc"
    data, at = with_entry(data, name), -1
    changed = bytearray(data)
    bad = rng.choice([b"\0", b"\n", b"\x1b"])
    while (at := changed.find(name.encode(), at + 1)) >= 0:
        changed[at + 10 : at + 11] = bad
    return bytes(changed)


def malformed_name(rng: Random, data: bytes) -> bytes:
    """Mark a name as UTF-8 that is not."""
    name = "resources/abc"
    changed, at = bytearray(patched(with_entry(data, name), name, 6, 8, "<H", 0x800)), -1
    while (at := changed.find(name.encode(), at + 1)) >= 0:
        changed[at + 10 : at + 13] = b"\xed\xa0\x80"
    return bytes(changed)


def cut(rng: Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data) - 1)]


def damaged(rng: Random, data: bytes) -> bytes:
    changed = bytearray(data)
    where = rng.choice([0, max(0, len(data) - 2000)])  # half of them where the table of contents is
    for _ in range(rng.choice([1, 1, 8])):
        changed[rng.randrange(where, len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def zeroed(rng: Random, data: bytes) -> bytes:
    at = rng.randrange(len(data))
    size = min(rng.choice([16, 512, 4096]), len(data) - at)
    return data[:at] + bytes(size) + data[at + size :]


def sound(rng: Random, data: bytes) -> bytes:
    """Change what may be changed: entries more, in another order, stored, with a comment."""
    entries = [*entries_of(data), (new_entry("extra/notes ä.txt"), b"x" * rng.randrange(5000))]
    rng.shuffle(entries)
    for entry, _ in entries:
        entry.compress_type = rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
    return packed(entries)


ATTACKS: dict[Attack, str] = {
    sound: "accept",
    doctype: "refuse",
    link: "refuse",
    outside: "refuse",
    twice: "refuse",
    encrypted: "refuse",
    method: "refuse",
    huge: "refuse",
    many: "refuse",
    long_contents: "refuse",
    long_xml: "refuse",
    deep_xml: "refuse",
    odd_name: "refuse",
    malformed_name: "refuse",
    cut: "refuse",
    damaged: "either",
    zeroed: "either",
}
PLACES = ("alone", "inside a package", "the package")


class Target:
    """A sound FMU and a sound package, and what they give."""

    def __init__(self, folder: Path) -> None:
        FmuBuilder.build_FMU(_SLAVE, folder)
        self.folder = folder
        self.fmu = (folder / "Gain.fmu").read_bytes()
        system = System().add("gain", folder / "Gain.fmu", {"a": 1.0, "b": 2.0})
        self.package = write_ssp(system, folder / "sound.ssp", stop_time=1.0, step_size=0.5).read_bytes()
        sound = {"fmu": self.fmu, "ssp": self.package}
        self.expected = {kind: self.run(self.write(data, kind)) for kind, data in sound.items()}

    def write(self, data: bytes, kind: str) -> Path:
        path = self.folder / f"attacked.{kind}"
        path.write_bytes(data)
        return path

    def run(self, path: Path) -> object:
        """Return what checking and running the file gives."""
        if path.suffix == ".ssp":
            report = check_ssp(path)
            run = simulate(path)
            assert report.passed, f"simulated, but not passed: {report}"
        else:
            run = simulate(path, start_values={"a": 1.0, "b": 2.0}, stop_time=1.0, step_size=0.5)
        return run.names, run.columns.tolist()

    def attacked(self, attack: Attack, place: str, rng: Random) -> Path:
        if place == "alone":
            return self.write(attack(rng, self.fmu), "fmu")
        if place == "the package":
            return self.write(attack(rng, self.package), "ssp")
        fmu = attack(rng, self.fmu)
        entries = entries_of(self.package)
        return self.write(packed([(e, fmu if e.filename.endswith(".fmu") else data) for e, data in entries]), "ssp")


def try_one(target: Target, attack: Attack, place: str, rng: Random) -> tuple[str, str]:
    """Return what came of an attack, and what is wrong with that, if anything."""
    path = target.attacked(attack, place, rng)
    begin = time.process_time()
    try:
        verdict, received = "accept", target.run(path)
        fault = "" if received == target.expected[path.suffix[1:]] else f"gave {received}"
    except NdobError as error:
        verdict, message = "refuse", str(error).replace(str(target.folder), "")
        fault = f"said {message!r}" if "\n" in message or len(message) > MESSAGE_LIMIT else ""
    except Exception as error:
        verdict, fault = "raw exception", repr(error)
    if ATTACKS[attack] not in ("either", verdict):
        fault = fault or f"expected to {ATTACKS[attack]}, received {verdict}"
    if (spent := time.process_time() - begin) > _MOST_SECONDS:
        fault = f"took {spent:.1f} s"
    if left := list(Path(tempfile.gettempdir()).iterdir()):
        fault = f"left {left}"
    return verdict, fault


def main() -> int:
    options = read_options("tests.attacks.archives", str(__doc__), trials=100)
    with tempfile.TemporaryDirectory() as folder:
        work, temporary = Path(folder, "work"), Path(folder, "temporary")
        work.mkdir()
        temporary.mkdir()
        target = Target(work)
        tempfile.tempdir = str(temporary)
        limit = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE") + _MOST_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        counts: Counter[str] = Counter()
        faults = []
        tried = [(attack, place) for place in PLACES for attack in ATTACKS]
        for trial in range(options.trials):
            rng = Random(f"{options.seed} {trial}")
            attack, place = tried[(trial * 7) % len(tried)]
            verdict, fault = try_one(target, attack, place, rng)
            counts[verdict] += 1
            if fault:
                faults.append(f"trial {trial}, {attack.__name__}, {place}: {fault}")
    return closing_line(options, counts, faults)


if __name__ == "__main__":
    raise SystemExit(main())
