"""result.csv, inputs.csv and summary.json of a run, written together, and read back only as they were written."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ndob_fmu.errors import UsageError
from ndob_fmu.results.csv_files import read_csv, write_csv
from ndob_fmu.results.json_files import read_sealed_json, write_sealed_json
from ndob_fmu.results.recording import Recording

RESULT = "result.csv"
SYSTEM_PICTURE = "system.svg"  # of the system that was simulated, beside the other files
_INPUTS = "inputs.csv"
_SUMMARY = "summary.json"
_DIGEST, _INPUTS_DIGEST = "result_sha256", "inputs_sha256"
_TABLES = ("parameters", "units", "versions", "connections", "step_ratios")


def write_run(folder: Path, recording: Recording, summary: Mapping[str, Any], inputs: Recording | None = None) -> None:
    """Write the files into ``folder``; raise UsageError if one cannot be written.

    inputs: what the inputs from a file had at each row of the recording.
    """
    write_csv(folder / RESULT, recording)
    digests = {}
    if inputs is not None:
        write_csv(folder / _INPUTS, inputs)
        digests[_INPUTS_DIGEST] = _digest(folder / _INPUTS)
    write_summary(folder, {**summary, **digests})


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write summary.json beside the result.csv that is there; raise UsageError if it cannot be written."""
    write_sealed_json(folder / _SUMMARY, {**summary, _DIGEST: _digest(folder / RESULT)})


def read_run(folder: Path) -> tuple[Recording, dict[str, Any], Recording | None]:
    """Return the signals of a run, its summary, and the inputs from a file if there were any.

    The summary is empty where the folder has none, as after fmpy. Raises UsageError for files that cannot be read or
    were changed since they were written.
    """
    result, summary = folder / RESULT, folder / _SUMMARY
    if not summary.exists():
        return read_csv(result), {}, None
    found = read_sealed_json(summary)
    _require_digest(result, found.pop(_DIGEST, None))
    inputs = None
    if _INPUTS_DIGEST in found:  # else an inputs.csv is of an earlier run
        _require_digest(folder / _INPUTS, found.pop(_INPUTS_DIGEST))
        inputs = read_csv(folder / _INPUTS)
    if wrong := [name for name in _TABLES if not isinstance(found.get(name, {}), dict)]:
        raise UsageError.report(str(summary), expected=f"a table {wrong[0]}", received=repr(found[wrong[0]]))
    return read_csv(result), found, inputs


def _require_digest(path: Path, digest: Any) -> None:
    if digest != _digest(path):
        raise UsageError.report(
            str(path),
            expected=f"the file that {_SUMMARY} was written with",
            received="another one",
            likely=f"it was edited or is damaged; without {_SUMMARY} it is read as it is",
        )


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(2**20):
                digest.update(block)
    except OSError as error:
        raise UsageError.report(str(path), expected="a file that can be read", received=str(error)) from error
    return digest.hexdigest()
