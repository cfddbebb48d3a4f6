"""What a run leaves behind: the recorded signals as a value, and files that are either whole or absent."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import platform
import re
import shutil
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndob_fmu import __version__
from ndob_fmu.errors import UsageError, nearest, one_of, some_of
from ndob_fmu.support.interrupts import held

SYSTEM_PICTURE = "system.svg"  # the name of the picture of the system in a folder of results
_VALUES_IN_A_BLOCK = 100_000  # a Python number takes 32 bytes: some megabytes
_SEAL = "sha256"  # the entry of a JSON file with the digest of the others
_TRUTH = re.compile(r"\b(?:true|false)\b", re.IGNORECASE)  # as fmpy, spreadsheets and JSON write them
_DTYPES = {"Integer": np.dtype(np.int64), "Enumeration": np.dtype(np.int64), "Boolean": np.dtype(np.bool_)}


@dataclass(frozen=True, eq=False)
class Recording:
    """Signals over time: row k of every array belongs to ``time[k]``.

    time: (rows,) in seconds. names: one per column, ``component.variable``. columns: (rows, len(names)), all as floats.
    types: the FMI type of each column; empty means Real throughout. units: of the columns that have one, by name.
    ended_early: which component ended the run before its stop time, when and why; empty if none did.
    Raises UsageError if the shapes contradict.
    """

    time: NDArray[np.float64]
    names: tuple[str, ...]
    columns: NDArray[np.float64]
    types: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    ended_early: str = ""
    _position: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        expected = (*self.time.shape, len(self.names))
        if self.time.ndim != 1 or self.columns.shape != expected or len(self.types) not in (0, len(self.names)):
            raise UsageError.report(
                "recording",
                expected=f"time (rows,), columns {expected} and one type per column or none",
                received=f"time {self.time.shape}, columns {self.columns.shape} and {len(self.types)} types",
            )
        object.__setattr__(self, "types", self.types or ("Real",) * len(self.names))
        object.__setattr__(self, "_position", {name: column for column, name in enumerate(self.names)})

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return one signal, (rows,), as float64, int64 or bool after its FMI type; raise UsageError if absent."""
        if name not in self._position:
            raise UsageError.report(
                "recording",
                expected=one_of("signal", self.names, name),
                received=repr(name),
                likely=nearest(name, self.names),
            )
        column = self._position[name]
        return self.columns[:, column].astype(_DTYPES.get(self.types[column], np.dtype(np.float64)))


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path to write to; it becomes ``path`` if the block succeeds, and vanishes if it fails.

    The temporary file lies in the same folder, which is made if missing, because only a rename within one file system
    is atomic; its ending is that of ``path``, because writers such as matplotlib take the format from it.
    Raises UsageError if the place cannot be written.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.stem}-{uuid.uuid4().hex[:12]}{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(target)
    except OSError as error:
        raise UsageError.report(str(target), expected="a file that can be written", received=str(error)) from error
    finally:
        with held(), suppress(OSError):  # where nothing could be written there is nothing to remove either
            temporary.unlink()


@contextmanager
def atomic_folder(folder: str | Path) -> Iterator[Path]:
    """Give a temporary folder; its files move into ``folder`` if the block succeeds, and vanish if it fails.

    Files of the same names are replaced, others stay. The temporary folder lies in ``folder``, made if it is missing.
    Raises UsageError if the place cannot be written.
    """
    target = Path(folder)
    new = not target.exists()
    temporary = target / f".{uuid.uuid4().hex[:12]}"
    try:
        temporary.mkdir(parents=True)
        yield temporary
        with held():
            for path in sorted(temporary.iterdir()):
                path.replace(target / path.name)
            new = False
    except OSError as error:
        raise UsageError.report(str(target), expected="a folder that can be written", received=str(error)) from error
    finally:
        with held():
            shutil.rmtree(temporary, ignore_errors=True)
            if new:
                with suppress(OSError):  # where it could not be made
                    target.rmdir()


def write_csv(path: str | Path, recording: Recording) -> None:
    """Write fmpy's CSV form: quoted header with ``time`` first, one row per communication point.

    Reals have every digit that makes them exact when read back; Booleans are 0 or 1. Raises UsageError if the file
    cannot be written; an older file then stays as it was.
    """
    formats = [repr] + [repr if kind == "Real" else _integer for kind in recording.types]
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        header = csv.writer(file, quoting=csv.QUOTE_ALL, lineterminator="\n")
        header.writerow(["time", *recording.names])
        block = max(1, _VALUES_IN_A_BLOCK // len(formats))
        for first in range(0, len(recording.time), block):
            rows = slice(first, first + block)
            for row in np.column_stack([recording.time[rows], recording.columns[rows]]).tolist():
                file.write(",".join([as_text(value) for as_text, value in zip(formats, row, strict=True)]) + "\n")


def _integer(value: float) -> str:
    return str(int(value))


def read_csv(path: str | Path) -> Recording:
    """Read fmpy's CSV form; every column becomes Real, since the form does not carry types: true is 1 and false 0.

    Raises UsageError if the file is missing, has no rows, does not begin with ``time``, names a column twice, or holds
    anything but numbers.
    """
    where = str(path)
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as file:  # -sig: spreadsheets write a byte-order mark
            names = next(csv.reader(file), [])
            if not names or names[0] != "time" or len(set(names)) != len(names):
                raise UsageError.report(
                    where,
                    expected='a header of different names, the first of them "time"',
                    received=some_of(names, between=",") if names else "an empty file",
                    likely="another separator than the comma, or no header line",
                )
            lines = (_with_numbers(line) for line in file if line.strip())  # one at a time: text takes much memory
            first = next(lines, None)
            rows = np.empty((0, len(names)))
            if first is not None:
                rows = np.loadtxt(chain([first], lines), delimiter=",", ndmin=2)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError.report(where, expected="a readable CSV file", received=str(error)) from error
    except ValueError as error:
        raise UsageError.report(where, expected="numbers separated by commas", received=str(error)) from error
    if rows.shape[0] == 0 or rows.shape[1] != len(names):
        received = f"{rows.shape[0]} rows of {rows.shape[1]} values"
        raise UsageError.report(where, expected=f"rows of {len(names)} values, as in the header", received=received)
    return Recording(rows[:, 0].copy(), tuple(names[1:]), rows[:, 1:].copy())


def _with_numbers(line: str) -> str:
    """Return a line with 1 and 0 for true and false."""
    # No number has one of these letters, and to look for them costs little.
    if "t" in line or "T" in line or "s" in line or "S" in line:
        return _TRUTH.sub(lambda word: str(int(word[0].lower() == "true")), line)
    return line


def write_json(path: str | Path, data: Any) -> None:
    """Write ``data`` (mappings, sequences, numbers, NumPy values, paths) as JSON; NaN and infinity become null.

    Raises UsageError if the file cannot be written; an older file then stays as it was.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(plain(data), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_sealed_json(path: str | Path, data: Mapping[str, Any]) -> None:
    """Write a mapping as `write_json`, with an entry ``sha256`` by which a reader notices that the others have changed.

    Raises UsageError if the file cannot be written; an older file then stays as it was.
    """
    entries = plain(dict(data))
    write_json(path, {**entries, _SEAL: _seal(entries)})


def read_sealed_json(path: str | Path) -> dict[str, Any]:
    """Return what `write_sealed_json` was given; raise UsageError for a file that is missing or has changed since."""
    where = str(path)
    try:
        found = json.loads(Path(path).read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError.report(where, expected="a JSON file that can be read", received=str(error)) from error
    if not isinstance(found, dict) or found.pop(_SEAL, None) != _seal(found):
        raise UsageError.report(
            where,
            expected=f"an object with the {_SEAL} of its entries",
            received="another one or none",
            likely="the file was edited, or the disk or a copy has damaged it",
        )
    return found


def _seal(entries: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()


def plain(value: Any) -> Any:
    """Return ``value`` in the types that JSON has; JSON has no NaN, and readers reject the one that Python writes."""
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return str(value) if isinstance(value, Path) else value


def software_versions(*more: str) -> dict[str, str]:
    """Return the versions of Python, of this package, of what every result depends on, and of the packages named."""
    names = ("fmpy", "pythonfmu", "numpy", *more)
    own = {"python": platform.python_version(), "ndob-fmu": __version__}
    return own | {name: version(name) for name in names}
