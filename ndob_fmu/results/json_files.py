"""JSON files of results, and those with a digest of their entries, by which a reader notices a change."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ndob_fmu.errors import UsageError
from ndob_fmu.support.files import atomic_path

_SEAL = "sha256"  # the entry of a JSON file with the digest of the others


def write_json(path: str | Path, data: Any) -> None:
    """Write ``data`` (mappings, sequences, numbers, NumPy values, paths) as JSON; NaN and infinity become null.

    Raises UsageError if the file cannot be written; an older file then stays as it was.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(json_value(data), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_sealed_json(path: str | Path, data: Mapping[str, Any]) -> None:
    """Write a mapping as `write_json`, with an entry ``sha256`` by which a reader notices that the others have changed.

    Raises UsageError if the file cannot be written; an older file then stays as it was.
    """
    entries = json_value(dict(data))
    write_json(path, {**entries, _SEAL: _seal(entries)})


def read_sealed_json(path: str | Path) -> dict[str, Any]:
    """Return what `write_sealed_json` was given; raise UsageError for a file that is missing or has changed since."""
    where = str(path)
    try:
        found = json.loads(Path(path).read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError.report(where, expected="a JSON file that can be read", received=str(error)) from error
    if not isinstance(found, dict) or found.pop(_SEAL, None) != _seal(found):
        raise UsageError.report(
            where,
            expected=f"an object with the {_SEAL} of its entries",
            received="another one or none",
            likely="the file was edited, or the disk or a copy has damaged it",
        )
    return found


def _seal(entries: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()


def json_value(value: Any) -> Any:
    """Return ``value`` in the types that JSON has; JSON has no NaN, and readers reject the one that Python writes."""
    if isinstance(value, np.ndarray | np.generic):
        return json_value(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): json_value(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(entry) for entry in value]
    return str(value) if isinstance(value, Path) else value
