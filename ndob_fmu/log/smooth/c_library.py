"""What takes the time with a long log, in C: the passes of the smoother, and the lines of a table.

The library knows no model. It is built once for this machine, where a C compiler is found; without one NumPy does the
same.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import cache
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.errors import UsageError
from ndob_fmu.log.smooth.linear_record import Adjoint, Forward, LinearRecord
from ndob_fmu.native.compile import PLATFORMS, binary, has_compiler, this_platform
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.temporary import temporary_folder

# Rows that are worth a call, and with the next ones a build.
MANY_ROWS = 500
_NAME = "ndob_log"
_FIELDS = ("Phi", "noise", "shift", "rows", "misfit", "variance", "start", "start_factor")
# Powers of ten by which numbers are written, and the most characters of one of them with what is behind it.
_POWERS, _LONGEST = range(-292, 325), 25


def c_library(rows: int) -> CLibrary | None:
    """Return the library for so many rows; None where they are few, and where there is none."""
    return _library() if rows >= MANY_ROWS else None


class CLibrary:
    """The library in a file. Each method is that of the same name in `smoother` or `csv_files`."""

    def __init__(self, path: Path) -> None:
        """Load it; raise OSError where that is impossible."""
        self._library = ctypes.CDLL(str(path))
        self._library.ndob_lines.restype = ctypes.c_size_t

    def forward(self, record: LinearRecord, jumps: Mapping[int, Array]) -> Forward:
        """Filter a record."""
        shape = record.rows.shape[:-2]
        p, N = record.rows.shape[-2:]
        found = Forward(*(np.empty((*shape, *one)) for one in ((N,), (N, N), (p, N), (p,), (p,))))
        self._call("ndob_forward", ctypes.byref(_Record(record, jumps)), _addresses(_columns(found)))
        return found

    def backward(self, record: LinearRecord, found: Forward) -> Adjoint:
        """Return the adjoint of a filtered record."""
        shape = record.rows.shape[:-2]
        p, N = record.rows.shape[-2:]
        adjoint = Adjoint(*(np.empty((*shape, *one)) for one in ((N,), (N, N), (p,), (p,))))
        told, filtered = ctypes.byref(_Record(record, {})), _columns(found)
        self._call("ndob_backward", told, _addresses(filtered), _addresses(_columns(adjoint)))
        return adjoint

    def lagged_adjoint(self, record: LinearRecord, found: Forward, rows: int) -> tuple[Array, Array]:
        """Return the scores (K,N) and their variances (K,N,N) at each row from its samples and those of more rows."""
        K, _, N = record.rows.shape
        scores = np.empty((K, N)), np.empty((K, N, N))
        told, length = ctypes.byref(_Record(record, {})), ctypes.c_size_t(min(rows + 1, K))
        filtered = _columns(found)
        self._call("ndob_lagged", told, _addresses(filtered), length, *map(_address, [*scores]))
        return scores

    def effects(
        self, record: LinearRecord, found: Forward, variances: Array, goes_on: Array, told: FollowedEvents, way: int
    ) -> list[tuple[Array, Array]]:
        """Return G and g of events from the rows beside theirs on, forwards or backwards, until they have no effect."""
        (E, N, c), p = told.x.shape, record.rows.shape[1]
        of_state, of_sample = np.empty((E, told.most, N, c)), np.empty((E, told.most, p, c))
        reach = np.zeros(E, dtype=np.uintp)
        arrays = [told.at.astype(np.uintp)]
        arrays += [np.ascontiguousarray(one) for one in (told.x, told.score, told.weight, variances, goes_on)]
        events = _Events(E, c, told.most, told.rows, told.forgotten, *(array.ctypes.data for array in arrays))
        filtered = _columns(found)
        passed = ctypes.byref(_Record(record, {})), _addresses(filtered), ctypes.byref(events)
        self._call("ndob_effects", *passed, ctypes.c_int(way), _addresses([of_state, of_sample, reach]))
        return [(G[:stop], g[:stop]) for G, g, stop in zip(of_state, of_sample, reach.tolist(), strict=True)]

    def lower_factor(self, rows: Array) -> Array:
        """Return lower triangles T (…,m,m) with T Tᵀ = rows rowsᵀ, for rows (…,m,·)."""
        rows = np.ascontiguousarray(rows)
        m, columns = rows.shape[-2:]
        found = np.empty((*rows.shape[:-1], m))
        sizes = map(ctypes.c_size_t, (prod(rows.shape[:-2]), m, columns))
        self._call("ndob_lower_factors", *sizes, _address(rows), _address(found))
        return found

    def transition(
        self, F: Array, channel: Array, H: Array, held: Array, parts: Array, units: Array, weights: Array
    ) -> tuple[Array, Array, Array]:
        """Return steps as `row_transition`; weights (terms,terms): of powers in the columns of the noise."""
        (K, N, _), c, h = F.shape, channel.shape[1], held.shape[1]
        found = np.empty((K, N, N)), np.empty((K, N, c, N)), np.empty((K, N, len(parts), h))
        arrays = [np.ascontiguousarray(one, dtype=float) for one in (F, H, channel, held, parts, units, weights)]
        steps = _Steps(K, N, c, h, len(parts), len(weights), *(array.ctypes.data for array in arrays))
        self._call("ndob_transitions", ctypes.byref(steps), _addresses(found))
        return found

    def explained_by(self, columns: Array, scores: Array, variances: Array) -> Array:
        """Return what events explain; −∞ where no variance is left."""
        K, N, c = columns.shape
        found = np.empty(K)
        arrays = [np.ascontiguousarray(one) for one in (columns, scores, variances)]
        self._call("ndob_explained", *map(ctypes.c_size_t, (K, N, c)), *map(_address, [*arrays, found]))
        return found

    def lines(self, rows: Array, whole: Sequence[int]) -> str:
        """Return rows as `csv_lines`."""
        rows = np.ascontiguousarray(rows)
        is_whole = np.zeros(rows.shape[1], dtype=np.uint8)
        is_whole[list(whole)] = 1
        text = np.empty(rows.size * _LONGEST, dtype=np.uint8)
        sizes, addresses = map(ctypes.c_size_t, rows.shape), (_address(one) for one in (rows, is_whole, text))
        length = self._library.ndob_lines(*sizes, *addresses)
        return text[:length].tobytes().decode("ascii")

    def _call(self, function: str, *arguments: object) -> None:
        if not getattr(self._library, function)(*arguments):
            raise MemoryError


class FollowedEvents(NamedTuple):
    """Events that are followed along a record, as `Events` in effects.c."""

    at: NDArray[np.intp]
    x: Array
    score: Array
    weight: Array
    most: int
    rows: int
    forgotten: float


class _Events(ctypes.Structure):
    """As `Events` in effects.c."""

    _fields_ = (
        *((name, ctypes.c_size_t) for name in ("E", "c", "most", "rows")),
        ("forgotten", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("at", "x", "score", "weight", "variances", "goes_on")),
    )


class _Steps(ctypes.Structure):
    """As `Steps` in transition.c."""

    _fields_ = (
        *((name, ctypes.c_size_t) for name in ("K", "N", "c", "h", "parts", "terms")),
        *((name, ctypes.c_void_p) for name in ("F", "H", "channel", "held", "shares", "units", "weights")),
    )


class _Record(ctypes.Structure):
    """As `Record` in passes.c."""

    _fields_ = (
        *((name, ctypes.c_size_t) for name in ("K", "S", "p", "N", "c")),
        *((name, ctypes.c_void_p) for name in _FIELDS),
        ("jumps", ctypes.c_size_t),
        *((name, ctypes.c_void_p) for name in ("jump_at", "jump_columns", "jump_values")),
    )

    def __init__(self, record: LinearRecord, jumps: Mapping[int, Array]) -> None:
        arrays = [np.ascontiguousarray(getattr(record, name), dtype=float) for name in _FIELDS]
        at = sorted(jumps)
        columns = np.array([jumps[k].shape[-1] for k in at], dtype=np.uintp)
        arrays += [
            np.array(at, dtype=np.uintp),
            columns,
            np.concatenate([np.zeros(0), *(jumps[k].ravel() for k in at)]),
        ]
        self._kept = arrays  # what the addresses belong to
        addresses = [array.ctypes.data for array in arrays]
        (K, *several, p, N), places = record.rows.shape, len(_FIELDS)
        sizes = (K, prod(several), p, N, record.noise.shape[-1])
        super().__init__(*sizes, *addresses[:places], len(at), *addresses[places:])


def _addresses(arrays: Sequence[NDArray[Any]]) -> ctypes.Array[ctypes.c_void_p]:
    """Return a structure of pointers to arrays, in their order."""
    return (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))


def _columns(found: Forward | Adjoint) -> list[Array]:
    """Return the arrays as C reads them; they have to live as long as it does."""
    return [np.ascontiguousarray(getattr(found, one.name)) for one in fields(found)]


def _address(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


@cache
def _library() -> CLibrary | None:
    target = this_platform()
    if not has_compiler(target):
        return None
    texts = [_c_text(name) for name in ("factor", "passes", "transition", "judge", "effects")]
    text = "\n".join([*texts, _powers_of_ten(), _c_text("text")])
    try:
        found = binary(_NAME, {f"{_NAME}.c": text}, target, level="-O3")
    except UsageError:
        return None
    with temporary_folder() as work, suppress(OSError):
        path = work / f"{_NAME}{PLATFORMS[target].suffix}"
        path.write_bytes(found)
        return CLibrary(path)
    return None


def _c_text(name: str) -> str:
    return (Path(__file__).parent / "c" / f"{name}.c").read_text("utf-8")


def _powers_of_ten() -> str:
    """Return a table in C of 10^k, the 128 leading bits of each, rounded up."""
    rows = []
    for k in _POWERS:
        # Of a power below 1 so many bits are wanted that its quotient has 128 or 129 of them.
        power = 10**k << 128 if k >= 0 else -(-(1 << 128 + (10**-k).bit_length()) // 10**-k)
        excess = power.bit_length() - 128
        bits = -(-power >> excess)
        rows.append(f"{{0x{bits >> 64:x}u, 0x{bits & (2**64 - 1):x}u}}")
    return f"static const uint64_t POWERS[][2] = {{{', '.join(rows)}}};"
