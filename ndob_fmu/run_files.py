"""result.csv and summary.json of a run, written together, and read back only as they were written."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ndob_fmu.errors import UsageError
from ndob_fmu.results import Recording, read_csv, read_sealed_json, write_csv, write_sealed_json

RESULT = "result.csv"
_SUMMARY = "summary.json"
_DIGEST = "result_sha256"
_TABLES = ("parameters", "units", "versions")


def write_run(folder: Path, recording: Recording, summary: Mapping[str, Any]) -> None:
    """Write both files into ``folder``; raise UsageError if one cannot be written."""
    write_csv(folder / RESULT, recording)
    write_sealed_json(folder / _SUMMARY, {**summary, _DIGEST: _digest(folder / RESULT)})


def read_run(folder: Path) -> tuple[Recording, dict[str, Any]]:
    """Return the signals of a run and its summary, which is empty where the folder has none, as after fmpy.

    Raises UsageError for files that cannot be read or were changed since they were written.
    """
    result, summary = folder / RESULT, folder / _SUMMARY
    if not summary.exists():
        return read_csv(result), {}
    found = read_sealed_json(summary)
    if found.pop(_DIGEST, None) != _digest(result):
        raise UsageError.report(
            str(result),
            expected=f"the file that {_SUMMARY} was written with",
            received="another one",
            likely=f"it was edited or is damaged; without {_SUMMARY} it is read as it is",
        )
    if wrong := [name for name in _TABLES if not isinstance(found.get(name, {}), dict)]:
        raise UsageError.report(str(summary), expected=f"a table {wrong[0]}", received=repr(found[wrong[0]]))
    return read_csv(result), found


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(2**20):
                digest.update(block)
    except OSError as error:
        raise UsageError.report(str(path), expected="a file that can be read", received=str(error)) from error
    return digest.hexdigest()
