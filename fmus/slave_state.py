"""The whole memory of a slave as one value, and that value as bytes which another process reads back to the last bit.

Only numbers, texts and the state classes that a slave names can come out of the bytes: what a host hands over is data
and never runs.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from ndob_fmu.runtime.base_errors import NdobError

_ARRAY, _TUPLE, _STATE = "array", "tuple", "state"
_DTYPES = ("<f8", "<i8", "|b1")


@dataclass(frozen=True)
class Snapshot:
    """All that a slave remembers.

    slave: the name of its class, whose module carries the digest of its code.
    values: of its variables, by value reference.
    started_with: the parameters of the core, None before it is made.
    core: its state, None before it is made.
    initializing, stale: as in `RememberingSlave`.
    start_time, stop_time: of the experiment (s).
    time: the end of the last step (s).
    step_size: the length of the last step (s), 0 before the first.
    """

    slave: str
    values: tuple[Any, ...]
    started_with: tuple[Any, ...] | None
    core: Any
    initializing: bool
    stale: bool
    start_time: float
    stop_time: float | None
    time: float
    step_size: float


@dataclass(frozen=True)
class Received:
    """A snapshot that came as bytes: of the right structure, with contents that the slave has yet to check."""

    snapshot: Snapshot


def to_bytes(snapshot: Snapshot) -> bytes:
    """Return the snapshot's bytes, the same for equal snapshots."""
    content = json.dumps(_plain(snapshot), separators=(",", ":")).encode()
    return hashlib.sha256(content).digest() + content


def from_bytes(data: bytes, state_types: tuple[type, ...]) -> Received:
    """Return the snapshot that `to_bytes` made these bytes of. Raises NdobError if it did not."""
    digest, content = data[:32], data[32:]
    try:
        if hashlib.sha256(content).digest() != digest:
            raise ValueError("bytes that are cut off, damaged or no FMU state")
        known = {state_type.__name__: state_type for state_type in (Snapshot, *state_types)}
        snapshot = _restored(json.loads(content.decode()), known)
        # What is written twice, in another form or besides is not in the bytes of what was read.
        named = isinstance(snapshot, Snapshot) and isinstance(snapshot.slave, str)
        if not named or to_bytes(snapshot) != data:
            raise ValueError("something else")
    except (ValueError, TypeError, KeyError, ArithmeticError, RecursionError) as error:
        raise NdobError.report(
            "FMU state", expected="the bytes of a state of this FMU", received=str(error) or repr(error)
        ) from error
    return Received(snapshot)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        coded = base64.b64encode(array.tobytes()).decode()
        return {_ARRAY: [array.dtype.str, list(value.shape), coded]}
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, tuple):
        return {_TUPLE: [_plain(item) for item in value]}
    if is_dataclass(value):
        return {_STATE: [type(value).__name__, *(_plain(getattr(value, field.name)) for field in fields(value))]}
    return value  # json writes a float with all the digits that tell it from its neighbours


def _restored(value: Any, known: Mapping[str, type]) -> Any:
    if not isinstance(value, dict):
        return value
    ((kind, content),) = value.items()
    if kind == _ARRAY:
        dtype, shape, coded = content
        if dtype not in _DTYPES:
            raise ValueError(f"an array of {dtype}")
        return np.frombuffer(base64.b64decode(coded), dtype=dtype).reshape(shape).copy()
    if kind == _TUPLE:
        return tuple(_restored(item, known) for item in content)
    if kind != _STATE:
        raise ValueError("something else")
    name, *attributes = content
    return known[name](*(_restored(item, known) for item in attributes))
