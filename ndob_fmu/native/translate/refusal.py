"""How the translator says what it does not understand."""

from __future__ import annotations

import ast

from ndob_fmu.errors import NdobError


class RefusedError(NdobError):
    """A part of the source that has no translation."""


def refused(file: str, node: ast.AST, expected: str, received: str) -> RefusedError:
    """Return the error for a node of a file."""
    line = getattr(node, "lineno", 0)
    return RefusedError(f"{file}:{line}: expected {expected}, received {received}")
