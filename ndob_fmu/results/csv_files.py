"""Recordings as CSV files in the form that fmpy writes and reads."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from ndob_fmu.errors import UsageError, some_of
from ndob_fmu.results.recording import Recording
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.files import atomic_path

_VALUES_IN_A_BLOCK = 100_000  # a Python number takes 32 bytes: some megabytes
Lines = Callable[[Array, Sequence[int]], str]
_TRUTH = re.compile(r"\b(?:true|false)\b", re.IGNORECASE)  # as fmpy, spreadsheets and JSON write them


def write_csv(path: str | Path, recording: Recording) -> None:
    """Write fmpy's CSV form: quoted header with ``time`` first, one row per communication point.

    Reals have every digit that makes them exact when read back; Booleans are 0 or 1. Raises UsageError if the file
    cannot be written; an older file then stays as it was.
    """
    write_csv_parts(path, [recording])


def csv_lines(rows: Array, whole: Sequence[int]) -> str:
    """Return rows (K,·) as lines of a CSV file; `whole`: places of the columns that hold whole numbers."""
    entries = rows.tolist()
    for row in entries:
        for place in whole:
            row[place] = int(row[place])
    # Python writes a list of lists as a whole in half the time of its numbers one by one.
    return repr(entries)[2:-2].replace("], [", "\n").replace(", ", ",") + "\n"


def write_csv_parts(path: str | Path, parts: Iterable[Recording], lines: Lines = csv_lines) -> None:
    """Write recordings of the same signals one after the other as `write_csv`; there must be at least one.

    lines: what writes rows as `csv_lines` does
    """
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        for i, recording in enumerate(parts):
            if i == 0:
                header = csv.writer(file, quoting=csv.QUOTE_ALL, lineterminator="\n")
                header.writerow(["time", *recording.names])
            whole = [place for place, kind in enumerate(recording.types, 1) if kind != "Real"]
            block = max(1, _VALUES_IN_A_BLOCK // (1 + len(recording.types)))
            for first in range(0, len(recording.time), block):
                some = slice(first, first + block)
                file.write(lines(np.column_stack([recording.time[some], recording.columns[some]]), whole))


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
