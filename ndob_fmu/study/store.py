"""The results folder of a study: which study it is, and the finished runs in Parquet shards.

study.json                      what was asked, and its fingerprint
shards/runs_<first>_<last>.parquet   rows of runs that finished together, whole or absent
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ndob_fmu.cosim import open_system
from ndob_fmu.cosim.picture import write_picture
from ndob_fmu.errors import UsageError, some_of
from ndob_fmu.results import SYSTEM_PICTURE, atomic_path, write_json
from ndob_fmu.study.columns import ENDED_AT, FAILED, REASON, RUN, TIME, WALL_TIME, over_time
from ndob_fmu.study.description import Study

_PLAN = "study.json"
_SHARDS = "shards"


class Store:
    """The folder of one study; ``finished``: (runs,), which runs have a row."""

    def __init__(self, folder: Path, study: Study) -> None:
        """Start or go on with the study in ``folder``.

        Raises UsageError if the folder holds another study, or what cannot be read, or cannot be written.
        """
        self.folder = folder
        self._schema = _schema(study)
        self.finished = np.zeros(len(study.points), dtype=np.bool_)
        self._succeeded = np.zeros(len(study.points), dtype=np.bool_)
        plan = folder / _PLAN
        if plan.exists():
            _require_same(plan, study)
        else:
            write_json(plan, {**study.to_dict(), "digest": study.digest})
            with open_system(study.system) as (system, _):
                write_picture(folder / SYSTEM_PICTURE, system, Path(study.system).name)
        for path in (folder / _SHARDS).glob(".runs_*"):  # of a command that was killed while it wrote
            path.unlink()
        for path in _shards(folder):
            self._count(_read(path, [RUN, FAILED]))

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Which runs have failed, (runs,)."""
        return self.finished & ~self._succeeded

    def save(self, rows: Sequence[dict[str, Any]]) -> None:
        """Keep finished runs for good; raise UsageError if they cannot be written, and keep those before."""
        table = pa.Table.from_pylist(sorted(rows, key=lambda row: int(row[RUN])), schema=self._schema)
        runs = table[RUN].to_numpy()
        stem = f"runs_{runs[0]:08d}_{runs[-1]:08d}"
        # Failed runs that are done again may begin and end like a shard that has others between them.
        path = self.folder / _SHARDS / f"{stem}.parquet"
        again = 0
        while path.exists():
            again += 1
            path = path.with_name(f"{stem}_{again}.parquet")
        with atomic_path(path) as temporary:
            pq.write_table(table, temporary)
        self._count(table)

    def forget_failures(self) -> None:
        """Have the failed runs done again; their new rows take the place of the old ones."""
        self.finished &= self._succeeded

    def _count(self, table: pa.Table) -> None:
        runs, failed = table[RUN].to_numpy(), table[FAILED].to_numpy()
        self.finished[runs] = True
        self._succeeded[runs[~failed]] = True


def read_plan(folder: Path) -> dict[str, Any]:
    """Return study.json; raise UsageError if there is none that can be read."""
    try:
        plan: dict[str, Any] = json.loads((folder / _PLAN).read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError.report(str(folder / _PLAN), expected="a study's plan", received=str(error)) from error
    return plan


def read_runs(folder: Path, *, signals: bool = False) -> pa.Table:
    """Return a row for each finished run, in the order of runs; signals: with the recorded signals over time.

    Raises UsageError for a shard that cannot be read.
    """
    tables = []
    for path in _shards(folder):
        schema = pq.read_schema(path)
        tables.append(_read(path, [entry.name for entry in schema if signals or not pa.types.is_list(entry.type)]))
    if not tables:
        raise UsageError.report(str(folder), expected="a study with finished runs", received="none")
    table = pa.concat_tables(tables)
    # The later row stands where a failed run was done again.
    order = pc.sort_indices(table, sort_keys=[(RUN, "ascending"), (FAILED, "ascending")])
    table = table.take(order)
    runs = table[RUN].to_numpy()
    return table.filter(pa.array(np.concatenate([[True], runs[1:] != runs[:-1]])))


def column(table: pa.Table, name: str) -> NDArray[Any]:
    """Return one column, (rows,); a number that a failed run lacks is NaN."""
    values = table[name].to_numpy()
    return np.asarray(values)


def _shards(folder: Path) -> Iterable[Path]:
    return sorted((folder / _SHARDS).glob("runs_*.parquet"))


def _read(path: Path, columns: Sequence[str]) -> pa.Table:
    try:
        return pq.ParquetFile(path).read(columns=list(columns))
    except (OSError, pa.ArrowException) as error:
        received = str(error).partition("\n")[0]
        raise UsageError.report(
            str(path), expected="a Parquet file with the runs of a study", received=received
        ) from error


def _schema(study: Study) -> pa.Schema:
    entries = [(RUN, pa.int64())]
    entries += [(name, _type(levels)) for name, levels in study.points.levels().items()]
    entries += [(name, pa.float64()) for name in study.measures]
    entries += [(FAILED, pa.bool_()), (REASON, pa.string()), (ENDED_AT, pa.float64()), (WALL_TIME, pa.float64())]
    if study.record:
        entries += [(name, pa.list_(pa.float64())) for name in (TIME, *map(over_time, study.record))]
    return pa.schema(entries)


def _type(levels: Sequence[Any]) -> pa.DataType:
    kinds = {type(level) for level in levels}
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int}:
        return pa.int64()
    return pa.float64() if kinds <= {int, float} else pa.string()


def _require_same(plan: Path, study: Study) -> None:
    found = read_plan(plan.parent)
    if found.get("digest") != study.digest:
        now = study.to_dict()
        changed = [key for key in now if key != "name" and found.get(key) != json.loads(json.dumps(now[key]))]
        raise UsageError.report(
            str(plan.parent),
            expected="an empty folder or the results of this very study",
            received="those of a study that differs in " + (some_of(changed) if changed else "its values or its FMUs"),
            likely="the study file or an FMU has changed; --out names another folder",
        )
