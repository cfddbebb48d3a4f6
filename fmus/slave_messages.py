"""What a slave says to its host: one line, which any host can show."""

from __future__ import annotations

from ndob_fmu.runtime.base_errors import MESSAGE_LIMIT, NdobError

# What computing with impossible numbers raises; LinAlgError is a ValueError.
_IMPOSSIBLE = (ArithmeticError, ValueError)


def failure(where: str, error: Exception) -> NdobError:
    """Return the exception of a computation as a message for users; `where` names the computation."""
    if isinstance(error, NdobError):
        return error
    received = f"{error} ({type(error).__name__})"
    if isinstance(error, _IMPOSSIBLE):
        return NdobError.report(where, expected="numbers that can be computed with", received=received)
    return NdobError.report(where, expected="a result", received=received, likely="a defect of this FMU; report it")


def printable(text: str) -> str:
    """Return the text as any host's logger can take it: one line, UTF-8, at most 300 characters, as a printf format."""
    line = " ".join(text.encode("utf-8", "backslashreplace").decode().split())
    if len(line) > MESSAGE_LIMIT:
        half = (MESSAGE_LIMIT - 1) // 2
        line = f"{line[:half]}…{line[-half:]}"
    return "".join(c if c.isprintable() else "?" for c in line).replace("%", "%%")
