"""The results folder of a study: which study it is, and the finished runs.

study.json     the study's description and its digest
shards/        rows of runs that finished together, each file whole or absent
damaged/       shards that were not as written, or of another study, whose runs were done again
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from ndob_fmu.cosim import open_system
from ndob_fmu.cosim.system.picture import write_picture
from ndob_fmu.errors import NdobError, UsageError, some_of
from ndob_fmu.results.json_files import json_value, write_sealed_json
from ndob_fmu.results.run_files import SYSTEM_PICTURE
from ndob_fmu.study.columns import ENDED_AT, FAILED, REASON, RUN, TIME, WALL_TIME, over_time
from ndob_fmu.study.plan import PLAN, read_plan
from ndob_fmu.study.shards import (
    DamagedShardError,
    ForeignShardError,
    read_shard,
    shard_paths,
    study_schema,
    unfinished_paths,
    write_shard,
)
from ndob_fmu.study.study import Study

_DAMAGED = "damaged"
_log = logging.getLogger(__name__)


class Store:
    """The folder of one study; ``finished``: (runs,), which runs have a row."""

    def __init__(self, folder: Path, study: Study) -> None:
        """Start or go on with the study in ``folder``.

        Shards that are damaged or belong to another study are moved to ``damaged``, with one line of warning. Raises
        UsageError if the folder holds another study, or cannot be read or written.
        """
        self.folder = folder
        self._schema = _schema(study)
        self._types = {entry.name: entry.type for entry in self._schema}
        self.finished = np.zeros(len(study.points), dtype=np.bool_)
        self._succeeded = np.zeros(len(study.points), dtype=np.bool_)
        kinds = {path: self._kind(path, study) for path in shard_paths(folder)}
        planned = _planned(folder, study)
        if planned is None and "foreign" in kinds.values() and "own" not in kinds.values():
            raise _another(folder, "runs of another one, without a valid study.json")
        if not planned:  # the shards are the study's, or there are none
            write_sealed_json(folder / PLAN, {**study.to_dict(), "digest": study.digest})
            with open_system(study.system) as (system, _):
                write_picture(folder / SYSTEM_PICTURE, system, Path(study.system).name)
        try:
            for path in unfinished_paths(folder):
                path.unlink()
            self._set_aside([path for path, kind in kinds.items() if kind != "own"], len(kinds))
        except OSError as error:
            raise UsageError.report(
                str(folder), expected="a folder that can be written", received=str(error)
            ) from error

    def _kind(self, path: Path, study: Study) -> str:
        """Count the runs of a shard if it is the study's own; return whether it is own, foreign or damaged."""
        try:
            table = read_shard(path, study.digest, len(study.points))
        except ForeignShardError:
            return "foreign"
        except DamagedShardError:
            return "damaged"
        if not table.schema.equals(self._schema):
            return "damaged"
        self._count(table)
        return "own"

    def _set_aside(self, paths: Sequence[Path], total: int) -> None:
        if not paths:
            return
        aside = self.folder / _DAMAGED
        aside.mkdir(exist_ok=True)
        for path in paths:
            path.replace(aside / path.name)
        _log.warning(
            "%s: %d of %d shards are damaged or of another study; they are in %s now, and their runs are done again",
            *(self.folder, len(paths), total, aside.name),
        )

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Which runs have failed, (runs,)."""
        return self.finished & ~self._succeeded

    def save(self, rows: Sequence[dict[str, Any]]) -> None:
        """Write finished runs to the folder; raise UsageError if they cannot be written. Earlier runs stay."""
        ordered = sorted(rows, key=lambda row: int(row[RUN]))
        columns = {name: [row.get(name) for row in ordered] for name in self._types}
        arrays = [_array(columns[name], kind) for name, kind in self._types.items()]
        table = pa.Table.from_arrays(arrays, schema=self._schema)
        write_shard(self.folder, table)
        self._count(table)

    def forget_failures(self) -> None:
        """Count failed runs as not done; their new rows replace the old ones."""
        self.finished &= self._succeeded

    def _count(self, table: pa.Table) -> None:
        runs, failed = table[RUN].to_numpy(), table[FAILED].to_numpy()
        self.finished[runs] = True
        self._succeeded[runs[~failed]] = True


def read_runs(folder: Path, *, signals: bool = False) -> pa.Table:
    """Return a row for each finished run, in the order of runs; signals: with the recorded signals over time.

    Raises UsageError for a shard that is damaged or of another study.
    """
    plan = read_plan(folder)
    tables = [read_shard(path, plan["digest"], plan["runs"], lists=signals) for path in shard_paths(folder)]
    if not tables:
        raise UsageError.report(str(folder), expected="a study with finished runs", received="none")
    try:
        table = pa.concat_tables(tables)
    except pa.ArrowException as error:
        raise UsageError.report(str(folder), expected="shards of one study", received=str(error)) from error
    if missing := {*plan["varied"], *plan["measures"]} - {*table.column_names}:
        raise UsageError.report(str(folder), expected="a column for each measure", received=f"none for {min(missing)}")
    # A failed run may have been done again: its later row counts.
    order = pc.sort_indices(table, sort_keys=[(RUN, "ascending"), (FAILED, "ascending")])
    table = table.take(order)
    runs = table[RUN].to_numpy()
    return table.filter(pa.array(np.concatenate([[True], runs[1:] != runs[:-1]])))


def column(table: pa.Table, name: str) -> NDArray[Any]:
    """Return one column, (rows,); a number that a failed run lacks is NaN."""
    values = table[name].to_numpy()
    return np.asarray(values)


def _schema(study: Study) -> pa.Schema:
    entries = [(RUN, pa.int64())]
    entries += [(name, _type(levels)) for name, levels in study.points.levels().items()]
    entries += [(name, pa.float64()) for name in study.measures]
    entries += [(FAILED, pa.bool_()), (REASON, pa.string()), (ENDED_AT, pa.float64()), (WALL_TIME, pa.float64())]
    if study.record:
        entries += [(name, pa.list_(pa.float64())) for name in (TIME, *map(over_time, study.record))]
    return study_schema(entries, study.digest)


def _type(levels: Sequence[Any]) -> pa.DataType:
    kinds = {type(level) for level in levels}
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int}:
        return pa.int64()
    return pa.float64() if kinds <= {int, float} else pa.string()


def _array(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    if kind == pa.string():  # an Enumeration may be given by names and by numbers
        values = [value if value is None else str(value) for value in values]
    return pa.array(values, kind)


def _planned(folder: Path, study: Study) -> bool | None:
    """Return whether study.json is that of the study, None if there is none that is valid; raise if it is another's."""
    try:
        found = read_plan(folder)
    except UsageError:
        return None
    if found["digest"] == study.digest:
        return True
    now = json_value(study.to_dict())
    changed = [key for key in now if key != "name" and found.get(key) != now[key]]
    raise _another(
        folder, "those of a study that differs in " + (some_of(changed) if changed else "its values or its FMUs")
    )


def _another(folder: Path, received: str) -> NdobError:
    return UsageError.report(
        str(folder),
        expected="an empty folder or the results of this very study",
        received=received,
        likely="the study file or an FMU has changed; --out names another folder",
    )
