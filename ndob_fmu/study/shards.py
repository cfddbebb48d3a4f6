"""Shards: files with the rows of finished runs, whose names tell whether they are as they were written.

shards/runs_<first>_<last>_<digest>.parquet     digest: of the file's bytes, 16 hexadecimal digits of SHA-256

Parquet's own checksums cover pages, not the schema and the footer: with them, some bit flips still change the table.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ndob_fmu.errors import NdobError, UsageError
from ndob_fmu.study.columns import FAILED, REASON, RUN, WALL_TIME
from ndob_fmu.support.files import atomic_path

SHARDS = "shards"
_DIGITS = 16
_NAME = re.compile(rf"runs_\d+_\d+_([0-9a-f]{{{_DIGITS}}})\.parquet")
_STUDY = b"ndob-fmu study"  # the key of the study's digest in the schema's metadata
_FIXED = {RUN: pa.int64(), FAILED: pa.bool_(), REASON: pa.string(), WALL_TIME: pa.float64()}


class DamagedShardError(UsageError):
    """A shard is not as it was written; its runs can be done again."""


class ForeignShardError(UsageError):
    """A shard belongs to another study."""


def study_schema(entries: Sequence[tuple[str, pa.DataType]], digest: str) -> pa.Schema:
    """Return the schema of a study's shards; digest: the study's."""
    return pa.schema(entries, metadata={_STUDY: digest})


def shard_paths(folder: Path) -> list[Path]:
    """Return the shards in a study's folder, in the order of their names."""
    return sorted((folder / SHARDS).glob("runs_*.parquet"))


def unfinished_paths(folder: Path) -> Iterator[Path]:
    """Yield the files of commands that were killed while they wrote."""
    return (folder / SHARDS).glob(".*.parquet")


def write_shard(folder: Path, table: pa.Table) -> Path:
    """Write rows that are in the order of runs as a shard of the study in ``folder``; return its path.

    Raises UsageError if it cannot be written.
    """
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    data = sink.getvalue().to_pybytes()
    runs = table[RUN].to_numpy()
    path = folder / SHARDS / f"runs_{runs[0]:08d}_{runs[-1]:08d}_{_digest(data)}.parquet"
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return path


def read_shard(path: Path, digest: str, total: int, *, lists: bool = True) -> pa.Table:
    """Return the rows of a shard of the study with this digest and this many runs; lists: with signals over time.

    Raises DamagedShardError for a file that is not as it was written, ForeignShardError for one of another study.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError.report(str(path), expected="a file that can be read", received=str(error)) from error
    named = _NAME.fullmatch(path.name)
    if named is None or named[1] != _digest(data):
        raise _damaged(path, "a file whose bytes have the digest in its name", "other bytes or another name")
    try:
        file = pq.ParquetFile(pa.BufferReader(data))
        schema = file.schema_arrow
        found = (schema.metadata or {}).get(_STUDY, b"").decode("ascii", "replace")
        if found != digest:
            raise ForeignShardError.report(
                str(path), expected=f"runs of the study {digest}", received=f"runs of {found or 'an unknown one'}"
            )
        names = [entry.name for entry in schema if lists or not pa.types.is_list(entry.type)]
        table = file.read(columns=names)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise _damaged(path, "a Parquet file", str(error)) from error
    _check(path, table, total)
    return table


def _check(path: Path, table: pa.Table, total: int) -> None:
    """Raise DamagedShardError unless columns and runs are those of a study, which a right digest does not show."""
    types = {entry.name: entry.type for entry in table.schema}
    wrong = {name: str(types.get(name)) for name, kind in _FIXED.items() if types.get(name) != kind}
    if wrong or len(types) < len(table.schema):
        raise _damaged(path, "the columns of a study", f"{wrong or 'a column twice'}")
    if table[RUN].null_count or table[FAILED].null_count:
        raise _damaged(path, "runs with a number", "rows without one")
    runs = table[RUN].to_numpy()
    if not len(runs) or runs.min() < 0 or runs.max() >= total or len(np.unique(runs)) < len(runs):
        raise _damaged(path, f"different runs from 0 to {total - 1}", "others")


def _damaged(path: Path, expected: str, received: str) -> NdobError:
    likely = "the disk or a copy has damaged it; `ndob-fmu sweep` does its runs again"
    return DamagedShardError.report(str(path), expected=expected, received=received, likely=likely)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:_DIGITS]
