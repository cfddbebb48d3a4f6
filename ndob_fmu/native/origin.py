"""What a native FMU of a model was made from, as a digest that it carries: so a stale one can be told."""

from __future__ import annotations

import hashlib
from dataclasses import astuple
from functools import cache
from pathlib import Path

import sympy

from ndob_fmu.codegen.emit import equations_text
from ndob_fmu.model.model import Model

ORIGIN = "documentation/origin.txt"
_PACKAGE = Path(__file__).parents[1]
# The folders whose files write an FMU's sources, or stand in them.
_WRITERS = ("codegen", "fmu", "interface", "native", "runtime")


def origin(model: Model) -> bytes:
    """Return a digest of a model, and of the files of this package that make an FMU of it.

    Start values that are given to `build` are no part of it: who runs an FMU sets them.
    """
    field = model.vector_field
    symbols = (field.x, field.u, field.d, field.p)
    equations = sympy.srepr((*symbols, *astuple(field.parts)))
    return hashlib.sha256("\0".join([_writers(), equations_text(model), equations]).encode()).hexdigest().encode()


@cache
def _writers() -> str:
    digest = hashlib.sha256()
    for folder in _WRITERS:
        for path in sorted((_PACKAGE / folder).rglob("*.*")):
            if path.suffix in (".py", ".c", ".h"):
                digest.update(f"\0{path.relative_to(_PACKAGE).as_posix()}\0".encode() + path.read_bytes())
    return digest.hexdigest()
