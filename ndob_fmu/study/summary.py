"""The summary of a study for people and scripts: measures, reasons of failures, runs per second."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv

from ndob_fmu.results.json_files import write_sealed_json
from ndob_fmu.results.versions import software_versions
from ndob_fmu.study.columns import ENDED_AT, FAILED, REASON, RUN, WALL_TIME
from ndob_fmu.study.plan import read_plan
from ndob_fmu.study.store import column, read_runs
from ndob_fmu.study.sweep import Tally
from ndob_fmu.support.files import atomic_path

_MOST_REASONS = 5


def summarize(folder: Path, tally: Tally) -> dict[str, Any]:
    """Write summary.json and runs.csv into a study's folder and return the summary.

    runs.csv has a row for each finished run, in the order of runs, and no times of day or of computing: the same study
    gives the same bytes. Raises UsageError if the folder has no finished run or a file cannot be written.
    """
    plan, table = read_plan(folder), read_runs(folder)
    with atomic_path(folder / "runs.csv") as temporary:
        csv.write_csv(table.drop_columns([WALL_TIME]), temporary)
    summary = {
        "study": plan["name"],
        "runs": plan["runs"],
        **statistics(table, plan),
        "last_call": {
            "runs": tally.done,
            "wall_time": tally.seconds,
            "runs_per_second": tally.done / tally.seconds if tally.seconds else None,
            "workers": tally.workers,
        },
        "versions": software_versions("distributed", "pyarrow"),
    }
    write_sealed_json(folder / "summary.json", summary)
    return summary


def statistics(table: pa.Table, plan: Mapping[str, Any]) -> dict[str, Any]:
    """Return how many runs have finished, failed and ended early, the frequent reasons, and what the measures are."""
    reasons = Counter(reason for reason in table[REASON].to_pylist() if reason)
    return {
        "finished": len(table),
        "failed": int(column(table, FAILED).sum()),
        "ended_early": int(np.isfinite(column(table, ENDED_AT)).sum()),
        "reasons": dict(reasons.most_common(_MOST_REASONS)),
        "measures": {name: _statistics(table, name) for name in plan["measures"]},
    }


def _statistics(table: pa.Table, name: str) -> dict[str, Any]:
    values, runs = column(table, name), column(table, RUN)
    finite = np.isfinite(values)
    if not finite.any():
        return {"finite": 0}
    known, runs = values[finite], runs[finite]
    return {
        "finite": int(finite.sum()),
        "min": float(known.min()),
        "median": float(np.median(known)),
        "max": float(known.max()),
        "run_of_min": int(runs[known.argmin()]),
        "run_of_max": int(runs[known.argmax()]),
    }


def as_text(summary: dict[str, Any]) -> str:
    """Return the summary as lines for a terminal."""
    last = summary["last_call"]
    head = f"{summary['study']}: {summary['finished']} of {summary['runs']} runs, {summary['failed']} failed"
    if summary["ended_early"]:
        head += f", {summary['ended_early']} ended early"
    if last["runs"]:
        head += (
            f"; {last['runs']} of them now in {last['wall_time']:.1f} s on {last['workers']} workers, "
            f"{last['runs_per_second']:.1f} runs/s"
        )
    width = max(map(len, summary["measures"]))
    lines = [head, f"  {'measure':{width}}  {'min':>11} {'(run)':>9}  {'median':>11}  {'max':>11} {'(run)':>9}"]
    for name, found in summary["measures"].items():
        if not found["finite"]:
            lines.append(f"  {name:{width}}  no finite value")
            continue
        low, high = f"({found['run_of_min']})", f"({found['run_of_max']})"
        lines.append(
            f"  {name:{width}}  {found['min']:11.4g} {low:>9}  {found['median']:11.4g}  {found['max']:11.4g} {high:>9}"
        )
    lines += [f"  failed {count} times: {reason}" for reason, count in summary["reasons"].items()]
    return "\n".join(lines)
