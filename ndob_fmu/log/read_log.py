"""Reading a log block by block: CSV as loggers and spreadsheets write it, or Parquet, of any length."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from itertools import chain, islice
from math import inf, nan
from pathlib import Path

import numpy as np

from ndob_fmu.errors import UsageError
from ndob_fmu.log.log import Found, Log
from ndob_fmu.log.log_columns import Columns, Signals, columns_of
from ndob_fmu.results.shown_time import seconds
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.extras import extra

BLOCK = 30_000  # rows: the smoother keeps some kilobytes of each
_LINES = 3000  # in memory at once
_SEPARATORS = (",", ";", "\t")
_MISSING = ("", "nan", "na", "n/a", "null", "none", "-")
_TRUTH = {"true": 1.0, "false": 0.0}
_DATE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}|\d{1,2}:\d{2}")
_WITH_UNIT = re.compile(r"[+-]?\d[\d.,]*(?:[eE][+-]?\d+)?\s*[^\W\d_][\w/.^*]*|[+-]?\d[\d.,]*\s*[%°]\w?")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")


def read_log(path: str | Path, signals: Signals, block: int = BLOCK) -> Iterator[Log]:
    """Yield a log in blocks of so many rows, so that a file may be larger than the memory.

    Rows are taken as they are. One with the time of the row before adds its samples to that. An empty entry is a sample
    that was not taken. An input that is missing is held, before the first one it has that one's value.

    Raises UsageError for a file that cannot be read, a column that is missing or holds text, an input that no row of
    the first block has, a time that is missing or goes back, and a file without two times.
    """
    where = str(path)
    is_parquet = Path(path).suffix.lower() in (".parquet", ".pq")
    blocks = _parquet(where, signals, block) if is_parquet else _csv(where, signals, block)
    kept, rows = np.empty((0, len(signals.all))), next(blocks, None)
    first, count = 1, Found()
    held: Array | None = None
    while rows is not None:
        following = next(blocks, None)
        _require_times(where, rows[:, 0], first, float(kept[-1, 0]) if len(kept) else -inf)
        first += len(rows)
        merged, overwritten = _merged(np.concatenate([kept, rows]), 1 + len(signals.inputs))
        count += Found(len(rows), len(kept) + len(rows) - len(merged), overwritten)
        # The next block may begin with another row of the last time.
        is_last = following is None and (len(merged) > 1 or held is not None)
        done, kept = (merged, merged[:0]) if is_last else (merged[:-1], merged[-1:])
        if len(done):
            held = _first_inputs(where, done, signals) if held is None else held
            log, held = _log(done, signals, held, count)
            count = Found()
            yield log
        rows = following
    if held is None:
        received = "no rows" if first == 1 else f"{first - 1} with one time"
        raise UsageError.report(where, expected="rows of at least two times below a header", received=received)


def _require_times(where: str, times: Array, first: int, before: float) -> None:
    """Raise UsageError where a time is missing or goes back; `before`: that of the row before the first one."""
    previous = np.concatenate([[before], times[:-1]])
    bad = ~(np.isfinite(times) & (times >= previous))
    if bad.any():
        k = int(np.argmax(bad))
        is_missing = not np.isfinite(times[k])
        raise UsageError.report(
            f"{where}, row {first + k}",
            expected="a time" if is_missing else f"a time of at least {seconds(previous[k])} s, that of the row before",
            received="none" if is_missing else f"{seconds(times[k])} s",
            likely="" if is_missing else "two logs in one file, or a clock that was set back",
        )


def _merged(rows: Array, first_output: int) -> tuple[Array, int]:
    """Return rows of different times, and how many rows had another number of an output than one of the same time.

    Those of one time have the last number of each column.
    """
    starts = np.flatnonzero(np.diff(rows[:, 0], prepend=-inf) > 0.0)
    if len(starts) == len(rows):
        return rows, 0
    merged, overwritten = rows[starts], 0
    for start, row in zip(np.repeat(np.arange(len(starts)), np.diff(starts, append=len(rows))), rows, strict=True):
        both = np.where(np.isfinite(row), row, merged[start])
        overwritten += bool(np.any(np.abs(both - merged[start])[first_output:] > 0.0))
        merged[start] = both
    return merged, overwritten


def _first_inputs(where: str, rows: Array, signals: Signals) -> Array:
    """Return the first number of each input (m,)."""
    inputs = rows[:, 1 : 1 + len(signals.inputs)]
    known = np.isfinite(inputs)
    for i, name in enumerate(signals.inputs):
        if not known[:, i].any():
            raise UsageError.report(where, expected=f"numbers in the column of {name}, an input", received="none")
    return np.asarray(inputs[np.argmax(known, axis=0), np.arange(len(signals.inputs))])


def _log(rows: Array, signals: Signals, held: Array, count: Found) -> tuple[Log, Array]:
    """Return rows as a log, and its last inputs (m,); `held`: those before it."""
    m = len(signals.inputs)
    inputs, outputs = np.concatenate([held[None], rows[:, 1 : 1 + m]]), rows[:, 1 + m :]
    missing = ~np.isfinite(inputs)
    latest = np.maximum.accumulate(np.where(missing, 0, np.arange(len(inputs))[:, None]), axis=0)
    inputs = np.take_along_axis(inputs, latest, axis=0)
    outputs = np.where(np.isfinite(outputs), outputs, nan)
    found = count + Found(missing_inputs=int(missing.sum()), missing_samples=int(np.isnan(outputs).sum()))
    return Log(rows[:, 0], inputs[1:], outputs, found), inputs[-1]


def _csv(where: str, signals: Signals, block: int) -> Iterator[Array]:
    """Yield the rows (K,S) of a CSV file, some lines in memory at a time."""
    try:
        with Path(where).open(encoding="utf-8-sig", newline="") as file:  # -sig: spreadsheets write a byte-order mark
            lines = (line for line in file if line.strip() and not line.lstrip().startswith("#"))
            first = next(lines, "")
            separator = max(_SEPARATORS, key=first.count)
            header = [
                name.strip() for name in next(csv.reader([first], delimiter=separator, skipinitialspace=True), [])
            ]
            columns = columns_of(where, header, signals)
            rows = np.empty((0, len(columns.places)))
            for part in _parts(where, lines, columns, len(header), separator, min(_LINES, block)):
                rows = np.concatenate([rows, part])
                if len(rows) >= block:
                    yield columns.converted(rows[:block])
                    rows = rows[block:]
            if len(rows):
                yield columns.converted(rows)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError.report(where, expected="a readable CSV file", received=str(error)) from error


def _parts(
    where: str, lines: Iterator[str], columns: Columns, width: int, separator: str, most: int
) -> Iterator[Array]:
    """Yield the rows (·,S) of lines, at most so many at once."""
    first = 1
    while some := list(islice(lines, most)):
        is_plain = not any('"' in line for line in some)
        rows = _plain(some, columns, separator) if is_plain else None
        if rows is not None:
            first += len(rows)
            yield rows
            continue
        # What stands in quotes may go on in the next line.
        rest = some if is_plain else chain(some, lines)
        numbered = enumerate(csv.reader(rest, delimiter=separator, skipinitialspace=True), first)
        while found := [
            _numbers(where, number, row, columns, width, separator) for number, row in islice(numbered, most)
        ]:
            first += len(found)
            yield np.array(found)


def _plain(lines: list[str], columns: Columns, separator: str) -> Array | None:
    """Return the rows of lines of numbers and empty entries; None where there is anything else."""
    empty, missing = 2 * separator, f"{separator}nan{separator}"
    texts = []
    for line in lines:
        text = line.rstrip("\r\n")
        if empty in text:
            text = text.replace(empty, missing).replace(empty, missing)
        texts.append(f"{text}nan" if text.endswith(separator) else text)
    try:
        return np.loadtxt(texts, delimiter=separator, usecols=columns.places, ndmin=2, comments=None)
    except ValueError:
        return None


def _numbers(where: str, number: int, row: list[str], columns: Columns, width: int, separator: str) -> list[float]:
    """Return the numbers of a row, whose own number counts from 1 on, in the columns that are read."""
    try:
        return [float(row[place]) for place in columns.places]
    except (ValueError, IndexError):
        pass
    if len(row) != width:
        raise UsageError.report(
            f"{where}, row {number}",
            expected=f"{width} entries, as in the header",
            received=str(len(row)),
            likely="the file was cut off, or has another separator",
        )
    return [
        _number(f"{where}, row {number}, column {name}", row[place].strip(), separator, is_first=number == 1)
        for place, name in zip(columns.places, columns.names, strict=True)
    ]


def _number(where: str, text: str, separator: str, *, is_first: bool) -> float:
    word = text.lower()
    if word in _MISSING:
        return nan
    if word in _TRUTH:
        return _TRUTH[word]
    if separator != "," and _DECIMAL_COMMA.fullmatch(text):
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError:
        likely = _no_number(text, is_first=is_first)
        raise UsageError.report(where, expected="a number", received=repr(text[:40]), likely=likely) from None


def _no_number(text: str, *, is_first: bool) -> str:
    """Return the likely cause of an entry that is no number; empty where none is known."""
    if _DECIMAL_COMMA.fullmatch(text):
        return "a decimal comma, in a file that is separated by commas; write semicolons between the entries"
    if _DATE.match(text):
        return "a date or a time of day; write the time in seconds, or in another unit that --unit names"
    if _WITH_UNIT.fullmatch(text):
        return "a unit behind the number; leave it out, --unit can name it"
    if is_first and not any(map(str.isdigit, text)):
        return "a second row of the header, as of units; delete it, --unit can name the units"
    return ""


def _parquet(where: str, signals: Signals, block: int) -> Iterator[Array]:
    """Yield the rows (K,S) of a Parquet file."""
    with extra("study"):
        import pyarrow
        import pyarrow.parquet
    try:
        with pyarrow.parquet.ParquetFile(where) as file:
            columns = columns_of(where, file.schema_arrow.names, signals)
            for batch in file.iter_batches(block, columns=sorted(set(columns.names))):
                each = [batch.column(name).cast(pyarrow.float64()) for name in columns.names]
                yield columns.converted(np.column_stack([one.to_numpy(zero_copy_only=False) for one in each]))
    except (OSError, pyarrow.ArrowException) as error:
        received = " ".join(str(error).split())
        raise UsageError.report(where, expected="a Parquet file of numbers", received=received) from error
