"""Binaries for macOS: the hashes of their pages, without which a Mac with its own processor loads none."""

from __future__ import annotations

import hashlib
import struct

from ndob_fmu.errors import UsageError

_FAT, _THIN = b"\xca\xfe\xba\xbe", b"\xcf\xfa\xed\xfe"
_HEADER_SIZE, _CODE_SIGNATURE = 32, 0x1D
_SIGNATURE, _CODE_DIRECTORY, _SHA256 = 0xFADE0CC0, 0xFADE0C02, 2


def signed(data: bytes) -> bytes:
    """Return a binary whose pages were changed with their present hashes; one of another system as it is.

    Raises UsageError for a signature with other hashes than SHA-256.
    """
    if data[:4] == _THIN:
        return _with_hashes(data)
    if data[:4] != _FAT:
        return data
    (count,) = struct.unpack_from(">I", data, 4)
    for each in range(count):
        place, size = struct.unpack_from(">II", data, 8 + 20 * each + 8)
        data = data[:place] + signed(data[place : place + size]) + data[place + size :]
    return data


def _with_hashes(data: bytes) -> bytes:
    at = _signature(data)
    if at is None:
        return data
    found = bytearray(data)
    (count,) = struct.unpack_from(">I", data, at + 8)
    for each in range(count):
        directory = at + struct.unpack_from(">I", data, at + 12 + 8 * each + 4)[0]
        if struct.unpack_from(">I", data, directory)[0] != _CODE_DIRECTORY:
            continue
        hashes, _, _, pages, limit, size, kind, _, page = struct.unpack_from(">IIIIIBBBB", data, directory + 16)
        if kind != _SHA256:
            raise UsageError.report("binaries/darwin64", expected="hashes of SHA-256", received=f"those of kind {kind}")
        for k in range(pages):
            content = data[k << page : min((k + 1) << page, limit)]
            place = directory + hashes + size * k
            found[place : place + size] = hashlib.sha256(content).digest()
    return bytes(found)


def _signature(data: bytes) -> int | None:
    """Return the place of the signature; None in a binary without one."""
    (commands,) = struct.unpack_from("<I", data, 16)
    at = _HEADER_SIZE
    for _ in range(commands):
        command, size, place = struct.unpack_from("<III", data, at)
        if command == _CODE_SIGNATURE:
            return int(place)
        at += size
    return None
