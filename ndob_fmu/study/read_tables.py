"""Reading how the parameters of a study vary."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ndob_fmu.cosim import Value
from ndob_fmu.errors import UsageError, some_of
from ndob_fmu.study.points import ParameterTable, Range, grid, latin_hypercube, listed, random
from ndob_fmu.study.toml_file import TomlTable

KINDS = ("grid", "list", "latin_hypercube", "random")
MOST_RUNS = 1_000_000
_MOST_VALUES = 10_000_000  # which still fit in some hundred megabytes
_RANGE = {"from", "to", "mean", "std"}


def read_tables(file: TomlTable, seed: int) -> Iterator[ParameterTable]:
    """Yield what the tables [grid], [list], [latin_hypercube] and [random] of a study file stand for.

    seed: of what is drawn. Raises UsageError for what cannot be read.
    """
    runs = 1
    for kind in KINDS:
        section = file.section(kind)
        if not section.entries:
            continue
        if kind in ("grid", "list"):
            columns = {name: _values(section, name, entry) for name, entry in flat(section.entries)}
            lengths = {name: len(values) for name, values in columns.items()}
            if kind == "list" and len(set(lengths.values())) > 1:
                received = some_of(f"{count} for {name}" for name, count in lengths.items())
                raise UsageError.report(section.where, expected="as many values for each name", received=received)
            runs *= math.prod(lengths.values()) if kind == "grid" else max(lengths.values())
            _check_runs(file, runs)
            _check_size(section, runs, len(columns))
            yield grid(columns) if kind == "grid" else listed(columns)
        else:
            count = section.count("runs", ..., 1, MOST_RUNS)
            entries = {name: entry for name, entry in section.entries.items() if name != "runs"}
            ranges = {name: _range(section, name, entry) for name, entry in flat(entries)}
            if not ranges:
                raise UsageError.report(section.where, expected="parameters with ranges", received="none")
            runs *= count
            _check_runs(file, runs)
            _check_size(section, count, len(ranges))
            yield latin_hypercube(ranges, count, seed) if kind == "latin_hypercube" else random(ranges, count, seed)


def _check_runs(file: TomlTable, runs: int) -> None:
    if runs > MOST_RUNS:
        received = f"{runs if runs < 10**18 else 'more than 10^18'}, every combination of the tables"
        raise UsageError.report(file.where, expected=f"at most {MOST_RUNS} runs", received=received)


def _check_size(section: TomlTable, rows: int, columns: int) -> None:
    if rows * columns > _MOST_VALUES:
        expected = f"at most {_MOST_VALUES} values, runs times parameters"
        raise UsageError.report(section.where, expected=expected, received=f"{rows} times {columns}")


def flat(entries: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield names with their dots, however they are written: ``a.b = 1``, ``"a.b" = 1`` or ``[section.a]``."""
    for name, entry in entries.items():
        ranged = isinstance(entry, dict) and any(key in _RANGE and not isinstance(entry[key], dict) for key in entry)
        if isinstance(entry, dict) and entry and not ranged:
            yield from flat(entry, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", entry


def _values(section: TomlTable, name: str, entry: Any) -> list[Value]:
    if isinstance(entry, dict):
        spread = TomlTable(f"{section.where}, {name}", entry)
        spread.only(["from", "to", "values", "scale"])
        count = spread.count("values", ..., 2, MOST_RUNS)
        return [float(value) for value in _limits(spread).at(np.linspace(0.0, 1.0, count))]
    if not isinstance(entry, list) or not entry or not all(isinstance(v, bool | int | float | str) for v in entry):
        raise section.wrong(
            name,
            "a list of values or { from = …, to = …, values = … }",
            entry,
            "a value for all runs belongs in [fixed]",
        )
    if not all(math.isfinite(v) for v in entry if isinstance(v, float)):
        raise section.wrong(name, "finite numbers", entry)
    if len(set(map(str, entry))) < len(entry) and not section.where.endswith("[list]"):
        raise section.wrong(name, "different values", entry)
    return list(entry)


def _range(section: TomlTable, name: str, entry: Any) -> Range:
    if not isinstance(entry, dict):
        raise section.wrong(name, "{ from = …, to = … } or { mean = …, std = … }", entry)
    spread = TomlTable(f"{section.where}, {name}", entry)
    if "mean" in entry or "std" in entry:
        spread.only(["mean", "std"])
        mean, deviation = spread.number("mean", ...), spread.number("std", ...)
        if not deviation > 0:
            raise spread.wrong("std", "a positive number", deviation)
        if not math.isfinite(10.0 * deviation + abs(mean)):
            raise spread.wrong("std", "one whose tenfold is finite beside the mean", deviation)
        return Range(mean, deviation, normal=True)
    spread.only(["from", "to", "scale"])
    return _limits(spread)


def _limits(spread: TomlTable) -> Range:
    low, high = spread.number("from", ...), spread.number("to", ...)
    scale = spread.get("scale", str, "linear", '"linear" or "log"')
    if scale not in ("linear", "log"):
        raise spread.wrong("scale", "'linear' or 'log'", scale)
    if not low < high:
        raise spread.wrong("to", f"a number above {low!r}", high)
    if not math.isfinite(high - low):
        raise spread.wrong("to", f"a number at a finite distance from {low!r}", high)
    if scale == "log" and low <= 0:
        raise spread.wrong("from", "a positive number, for the scale is logarithmic", low)
    return Range(low, high, log=scale == "log")
