"""Study files with any TOML value in any place: each is a valid study, or is refused in one line.

A valid study can be kept: its folder is made and two of its runs are written. No file takes long or much memory.
"""

from __future__ import annotations

import copy
import datetime
import json
import math
import os
import resource
import shutil
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from pythonfmu.builder import FmuBuilder

from ndob_fmu.errors import MESSAGE_LIMIT, NdobError
from ndob_fmu.study import read_study
from ndob_fmu.study.store import Store, read_runs

from .options import closing_line, read_options

_SLAVE = Path(__file__).parents[1] / "helpers" / "coupling_slaves" / "integrator.py"
_MOST_MEMORY = 3 * 2**30  # bytes of address space beyond what the process has at the start
_MOST_SECONDS = 30.0  # of the processors, for a million runs
_STUDY: dict[str, Any] = {
    "system": "Integrator.fmu",
    "seed": 3,
    "record": ["y"],
    "simulation": {"start_time": 0.0, "stop_time": 1.0, "output_interval": 0.5, "scheme": "gauss-seidel"},
    "fixed": {},
    "grid": {"step_size": [0.125, 0.25]},
    "list": {"Integrator": {"u": {"from": 1.0, "to": 2.0, "values": 2}}},
    "random": {"runs": 2, "Integrator.y": {"mean": 1.0, "std": 0.5}},
    "measures": {"end": {"of": "y", "take": "final", "minus": "half", "after": 0.5, "within": 0.1}},
}
_NAMES = ("y", "u", "half", "Integrator.u", "Integrator.y", "run", "time", "reason", "y(t)", "step_size")
_KEYS = (
    "from",
    "to",
    "mean",
    "std",
    "runs",
    "values",
    "scale",
    "order",
    "of",
    "take",
    "grid",
    "random",
    "latin_hypercube",
)
_CHOICES = ("min", "settling_time", "log", "linear", "jacobi", "", "\0", "a\nb")


class Text:
    """TOML that Python itself could not write: thousands of digits or brackets."""

    def __init__(self, text: str) -> None:
        self.text = text


texts = st.sampled_from(_NAMES + _KEYS + _CHOICES) | st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
numbers = (
    st.sampled_from([0.25, 0.5, 1.0, 2, 3])
    | st.integers(-(10**20), 10**20)
    | st.sampled_from([-5, 0, 1, 2, 10**6, 10**12, 10**100, 2**63, -(2**63)])
    | st.floats()
    | st.sampled_from([math.nan, math.inf, 1e12, 1e308, -1e308, 5e-324])
)
dates = st.datetimes().map(lambda value: value.replace(microsecond=0)) | st.dates() | st.times()
plain = texts | numbers | st.booleans() | dates
tables = st.dictionaries(texts, plain, max_size=4)
extremes = st.integers(1, 5000).flatmap(
    lambda size: st.sampled_from(
        [Text("[" * size + "]" * size), Text("9" * size), Text("{a=" * size + "1" + "}" * size)]
    )
)
ranges = st.fixed_dictionaries(
    {}, optional=dict.fromkeys(("from", "to", "mean", "std", "values"), numbers) | {"scale": texts}
)
values = st.recursive(
    plain | ranges, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4)
)
likely = st.sampled_from(
    [
        0.25,
        0.5,
        1,
        2,
        True,
        "min",
        "y",
        "u",
        "half",
        [0.5, 1.0],
        [1, 2],
        [1, "1.5"],
        [True, 0],
        ["jacobi"],
        ["Integrator"],
    ]
) | st.sampled_from(
    [{"from": 0.1, "to": 2, "values": 3, "scale": "log"}, {"from": -1, "to": 1}, {"mean": 0, "std": 1}, {"u": [1, 2]}]
)
used = st.booleans().flatmap(lambda usual: likely if usual else values | extremes)
edits = st.tuples(st.sampled_from(["replace", "add", "delete"]), st.integers(0, 10**6), texts, used)


def places(table: dict[str, Any]) -> list[tuple[dict[str, Any], str]]:
    """Return all entries, each with the table that it is in."""
    found = [(table, name) for name in table]
    return found + [place for value in table.values() if isinstance(value, dict) for place in places(value)]


def edited(changes: list[tuple[str, int, str, Any]]) -> dict[str, Any]:
    study = copy.deepcopy(_STUDY)
    for action, position, name, value in changes:
        everywhere = places(study)
        if not everywhere:
            break
        table, entry = everywhere[position % len(everywhere)]
        if action == "replace":
            table[entry] = copy.deepcopy(value)
        elif action == "delete":
            del table[entry]
        else:
            inside = table[entry] if isinstance(table[entry], dict) else table
            inside[name] = copy.deepcopy(value)
    return study


def toml(value: Any) -> str:
    """Return a value as TOML; tables are inline."""
    if isinstance(value, Text):
        return value.text
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, str):
        return json.dumps(value).replace("\x7f", "\\u007f")
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(name)} = {toml(entry)}" for name, entry in value.items()) + "}"
    return "[" + ", ".join(map(toml, value)) + "]"


def keep(path: Path, folder: Path) -> None:
    """Read a study and keep two runs of it, as a sweep does."""
    study = read_study(path)
    store = Store(folder, study)
    last = len(study.points) - 1
    measured = dict.fromkeys(study.measures, 0.5)
    store.save([{"run": 0, **study.points[0], **measured, "failed": False, "wall_time": 0.1}])
    if last:
        store.save([{"run": last, **study.points[last], "failed": True, "reason": "tried", "wall_time": 0.1}])
    assert len(read_runs(folder)) == min(2, last + 1)


def main() -> int:
    options = read_options("tests.attacks.study_files", str(__doc__), trials=1000)
    counts: Counter[str] = Counter()
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        FmuBuilder.build_FMU(_SLAVE, folder)
        path = folder / "study.toml"
        limit = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE") + _MOST_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

        path.write_text("\n".join(f"{toml(key)} = {toml(value)}" for key, value in _STUDY.items()), "utf-8")
        keep(path, folder / "sound")

        @seed(options.seed)
        @settings(
            max_examples=options.trials,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(st.lists(edits, min_size=1, max_size=2))
        def attack(changes: list[tuple[str, int, str, Any]]) -> None:
            text = "\n".join(f"{toml(key)} = {toml(value)}" for key, value in edited(changes).items())
            path.write_text(text, "utf-8")
            begin, fault = time.process_time(), ""
            try:
                keep(path, folder / "results")
                counts["valid"] += 1
            except NdobError as error:
                counts["refused in one line"] += 1
                message = str(error)
                fault = f"said {message!r}" if "\n" in message or len(message) > MESSAGE_LIMIT else ""
            except Exception as error:
                counts["raw exceptions"] += 1
                fault = repr(error)[:300]
            if (spent := time.process_time() - begin) > _MOST_SECONDS:
                fault = f"took {spent:.1f} s"
            if fault:
                faults.append(f"{fault}\n    {text[:1000]!r}")
            shutil.rmtree(folder / "results", ignore_errors=True)

        attack()
    return closing_line(options, counts, faults)


if __name__ == "__main__":
    raise SystemExit(main())
