"""Every error of the package, one line each: what was expected, what was received, the likely cause."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from ndob_fmu.runtime.base_errors import MESSAGE_LIMIT, AssumptionError, DesignError, NdobError, shortened

_LISTED = 100  # characters: longer lists are shortened to a few names and a count
_NEAREST = 3


class UsageError(NdobError):
    """A value or a name given by the caller cannot be used."""


class ModelError(NdobError):
    """A model is missing, cannot be read, or contradicts itself."""


class CouplingError(NdobError):
    """The components of a system cannot be connected as described."""


class SimulationError(NdobError):
    """A component failed while the coupled system ran."""

    exit_code = 1


def one_of(kind: str, names: Iterable[str], received: object = None) -> str:
    """Return a text for the names that were expected, to follow "expected".

    kind: what the names are, in the singular. All of them are listed where there are few; of many their number and
    those nearest to ``received``.
    """
    known = list(dict.fromkeys(names))
    if not known:
        return f"the name of a {kind}, but there are no {_plural(kind)}"
    if len(known) == 1:
        return f"the {kind} {known[0]}"
    if len(", ".join(known)) <= _LISTED:
        return f"one of the {_plural(kind)} {', '.join(known)}"
    near = difflib.get_close_matches(str(received), known, n=_NEAREST, cutoff=0.4) or known[:_NEAREST]
    shown = ", ".join(shortened(name, _LISTED // 2) for name in near)
    return f"one of the {len(known)} {_plural(kind)}, such as {shown}"


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the likely cause of an unknown name: the known one that is nearest; empty if none is near.

    Those that only have more in front, or more behind a dot, are nearest: of `noise_std`, all `<output>_noise_std`, of
    `disturbance_bound`, all `disturbance_bound.<name>`.
    """
    names = list(known)
    longer = [other for other in names if other.endswith(f"_{name}") or other.startswith(f"{name}.")]
    near = longer or difflib.get_close_matches(name, names, n=1)
    return f"did you mean {some_of(map(repr, near), between=' or ')}?" if near else ""


def some_of(names: Iterable[str], *, between: str = ", ") -> str:
    """Return names one after another: all if they are few, else the first of them and how many more there are.

    between: what stands between them. A list without names is "none".
    """
    known = list(names)
    shown: list[str] = []
    while len(shown) < len(known) and len(between.join([*shown, known[len(shown)]])) <= _LISTED:
        shown.append(known[len(shown)])
    shown = shown or [shortened(name, _LISTED) for name in known[:1]]
    more = len(known) - len(shown)
    return between.join(shown) + (f" and {more} more" if more else "") if known else "none"


def _plural(kind: str) -> str:
    noun, of, rest = kind.partition(" of ")
    return f"{noun[:-1]}ies{of}{rest}" if noun.endswith("y") else f"{noun}s{of}{rest}"


__all__ = [
    "MESSAGE_LIMIT",
    "AssumptionError",
    "CouplingError",
    "DesignError",
    "ModelError",
    "NdobError",
    "SimulationError",
    "UsageError",
    "nearest",
    "one_of",
    "shortened",
    "some_of",
]
