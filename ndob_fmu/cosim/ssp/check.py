"""Checking a package without running it. After a check that fails, the later ones are skipped."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from ndob_fmu.cosim.fmi.zip_archive import Archive, open_archive
from ndob_fmu.cosim.ssp.read_package import Package, read_components, read_system
from ndob_fmu.cosim.ssp.schema import ROOTS_BY_SUFFIX
from ndob_fmu.cosim.ssp.timing import read_experiment
from ndob_fmu.cosim.system.loops import algebraic_loops
from ndob_fmu.cosim.system.picture import write_picture
from ndob_fmu.cosim.system.system import System
from ndob_fmu.cosim.system.wiring import keep_start_values, undriven_inputs, without_driver
from ndob_fmu.errors import CouplingError, NdobError, UsageError, shortened, some_of
from ndob_fmu.support.temporary import temporary_folder

_Found = TypeVar("_Found")
_MARKS = {True: "ok  ", False: "FAIL", None: "    "}


class _Warning(str):
    """A finding that a run will log as a warning."""


@dataclass(frozen=True)
class SystemCheck:
    """One check.

    passed: None where a failure before it leaves nothing to check.
    found: what is there, or the error.
    warning: whether a run works, and warns of what was found.
    """

    name: str
    passed: bool | None
    found: str
    warning: bool = False


@dataclass(frozen=True)
class SystemReport:
    """All checks of a package, in their order."""

    path: Path
    rows: tuple[SystemCheck, ...]

    @property
    def passed(self) -> bool:
        """Whether the package can be run."""
        return all(row.passed for row in self.rows)

    def __str__(self) -> str:
        failed = sum(row.passed is False for row in self.rows)
        warned = sum(row.warning for row in self.rows)
        verdict = f"{failed} of {len(self.rows)} checks FAIL" if failed else f"all {len(self.rows)} checks pass"
        verdict += f", {warned} with a warning" if warned else ""
        width = max(len(row.name) for row in self.rows)
        lines = [
            f"  {'warn' if row.warning else _MARKS[row.passed]}  {row.name:<{width}}  {row.found}" for row in self.rows
        ]
        return "\n".join([f"{self.path}: {verdict}", *lines])

    def to_json(self) -> str:
        """Return the report as JSON."""
        report: dict[str, Any] = {"system": str(self.path), "passed": self.passed}
        return json.dumps({**report, "rows": [asdict(row) for row in self.rows]}, indent=2, ensure_ascii=False)


def check_ssp(path: str | Path, *, strict: bool = False, picture: str | Path | None = None) -> SystemReport:
    """Check the files by their schemas, the FMUs, the connections with types and units, and what drives the inputs.

    strict: an input that nothing drives fails; else it is a warning, as in a run.
    picture: where to draw the system (.svg), if it passes. Raises UsageError if there is no such package
    or the picture cannot be written. Nothing is left of what was unpacked.
    """
    path = Path(path)
    checks = _Checks()
    with temporary_folder() as folder:
        system = None
        if checks.run("archive", lambda: _archive(path)):
            with open_archive(path) as archive:
                system = _system(checks, Package(path, archive), archive, folder, strict)
        report = SystemReport(path, tuple(checks.rows))
        if report.passed and system is not None and picture is not None:
            write_picture(picture, system, path.stem)
    return report


class _Checks:
    """The rows so far; after the first failure nothing more is checked, since it would depend on what failed."""

    def __init__(self) -> None:
        self.rows: list[SystemCheck] = []

    def run(self, name: str, check: Callable[[], tuple[_Found, str]]) -> _Found | None:
        """Run one check, which returns what the next ones need and a line about it; None if it fails."""
        if any(not row.passed for row in self.rows):
            self.rows.append(SystemCheck(name, None, "not checked"))
            return None
        try:
            found, text = check()
        except UsageError as error:
            if not self.rows:  # there is no package to check
                raise
            self.rows.append(SystemCheck(name, False, str(error)))
            return None
        except NdobError as error:
            self.rows.append(SystemCheck(name, False, str(error)))
            return None
        self.rows.append(SystemCheck(name, True, shortened(text), isinstance(text, _Warning)))
        return found


def _archive(path: Path) -> tuple[bool, str]:
    with open_archive(path) as archive:
        try:
            archive.test()
        except CouplingError as error:  # a later check fails if the system needs the entry
            return True, _Warning(str(error))
        return True, f"{len(archive.namelist())} entries, none outside its folder"


def _system(checks: _Checks, package: Package, archive: Archive, folder: Path, strict: bool) -> System | None:
    def schemas() -> tuple[Any, str]:
        root = package.description()
        unused = package.check_files(root)
        count = sum(Path(name).suffix in ROOTS_BY_SUFFIX for name in archive.namelist())
        return root, _Warning("; ".join(unused)) if unused else f"{count} files that follow SSP 1.0"

    root = checks.run("files", schemas)
    parts = checks.run("components", lambda: _with(read_components(package, root, archive, folder)))

    def connected() -> tuple[System, str]:
        assert parts is not None  # else this is not run
        step_size = read_experiment(package.where, root).step_size
        system = read_system(package, root, parts, step_size)
        scaled = sum((c.factor, c.offset) != (1.0, 0.0) for c in system.connections)
        ends = f", {len(system.inputs)} inputs and {len(system.outputs)} outputs at the boundary"
        if system.warnings:
            return system, _Warning("; ".join(system.warnings))
        return system, f"{len(system.connections)} connections, {scaled} of them scaled or converted{ends}"

    system = checks.run("connections", connected)
    checks.run("inputs", lambda: _driven(system, strict))
    checks.run("algebraic loops", lambda: _loops(system))
    return system


def _with(parts: dict[str, Any]) -> tuple[dict[str, Any], str]:
    return parts, f"{len(parts)} from {len({part.path for part in parts.values()})} FMUs: {some_of(parts)}"


def _driven(system: System | None, strict: bool) -> tuple[None, str]:
    assert system is not None
    undriven = undriven_inputs(system)
    if undriven and strict:
        raise without_driver(undriven)
    return None, _Warning(keep_start_values(undriven)) if undriven else "each has a connection or a start value"


def _loops(system: System | None) -> tuple[None, str]:
    assert system is not None
    loops = [loop for loop in algebraic_loops(system, initial=True) if loop.declared]
    return None, some_of(map(str, loops), between="; ") if loops else "none that the FMUs declare"
