"""Compare what is installed with the lower bounds that pyproject.toml declares.

python -m tests.lower_bounds      prints a line for each package that is not installed at its bound; exits with 1 then
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from importlib.metadata import distributions, requires, version

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

PROJECT = "ndob-fmu"
EXTRA = "test"  # which has all other extras in it


def needed(requirements: Iterable[str], extra: str = "") -> list[Requirement]:
    """Return those of the requirements that hold for this Python and this extra."""
    found = map(Requirement, requirements)
    return [one for one in found if one.marker is None or one.marker.evaluate({"extra": extra})]


def not_at_bound(
    requirements: Iterable[Requirement], version_of: Callable[[str], str], reasons: Callable[[str], Iterable[str]]
) -> list[str]:
    """Return a line for each requirement whose lower bound is not the installed version.

    version_of: the installed version of a package. reasons: which installed packages need which versions of a package.
    """
    lines = []
    for one in requirements:
        bound = next((each.version for each in one.specifier if each.operator == ">="), None)
        installed = version_of(one.name)
        if bound is None or Version(bound) != Version(installed):
            others = ", ".join(reasons(canonicalize_name(one.name)))
            why = f"needed by {others}" if others else "no such release, or others exclude what it needs"
            lines.append(f"{one.name}: expected the lower bound {bound}, received {installed}; {why}")
    return lines


def _dependents(package: str) -> list[str]:
    """Return who needs which versions of a package, the project itself left out."""
    return sorted(
        f"{other.metadata['Name']} {other.version} ({one.specifier})"
        for other in distributions()
        if canonicalize_name(other.metadata["Name"]) != PROJECT
        for one in needed(other.requires or ())
        if canonicalize_name(one.name) == package and one.specifier
    )


def main() -> int:
    """Print what is not at its bound; return the exit code."""
    direct = [one for one in needed(requires(PROJECT) or (), EXTRA) if one.name != PROJECT]
    lines = not_at_bound(direct, version, _dependents)
    counts = f"{len(direct) - len(lines)} of {len(direct)} direct dependencies are at their lower bounds"
    print(*lines, counts, sep="\n")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
