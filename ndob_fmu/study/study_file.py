"""Reading a study file. It is checked against its system before anything runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from ndob_fmu.cosim import FmuComponent, System, Value, open_system
from ndob_fmu.cosim.master.schemes import SCHEMES
from ndob_fmu.errors import UsageError, nearest, one_of
from ndob_fmu.study.checks import check_coupling, check_names, check_times, outputs, resolver, unit_of_name
from ndob_fmu.study.columns import RESERVED, over_time
from ndob_fmu.study.measures import SETTLING_TIME, TAKES, Measure
from ndob_fmu.study.points import Points
from ndob_fmu.study.read_tables import KINDS, flat, read_tables
from ndob_fmu.study.study import STEP_SIZE, Simulation, Study
from ndob_fmu.study.toml_file import TomlTable, read_toml

_SECTIONS = ("system", "seed", "record", "simulation", "fixed", *KINDS, "measures")


def read_study(path: str | Path, system: str | Path | None = None) -> Study:
    """Return the study that a TOML file describes; docs/studies.md says how.

    system: the path of an .ssp or .fmu in place of that of the file, as the same system with native FMUs

    Raises UsageError for a file that cannot be read or says what cannot be, CouplingError for names that the system
    does not have, and what opening the system raises.
    """
    path = Path(path)
    file = read_toml(path)
    file.only(_SECTIONS)
    of_file = path.parent / str(file.path("system", ..., '"path of an .ssp or .fmu"'))
    system = of_file if system is None else Path(system)
    simulation = _simulation(file.section("simulation"), path.parent)
    seed = file.count("seed", 1, 0, 2**63 - 1)
    fixed = dict(_fixed(file.section("fixed")))
    points = Points(tuple(read_tables(file, seed)))
    _check_points(file, simulation, points, fixed)
    with open_system(system, simulation.step_size) as (opened, experiment):
        check_names(file, opened, points, fixed)
        resolve = resolver(file.where, opened)
        measures = dict(_measures(file.section("measures"), resolve))
        if not measures:
            measures = {name: Measure(name, "final") for name in outputs(opened)}
        record = tuple(resolve("record", name) for name in file.names("record", [], "a list of signals"))
        steps, last = check_times(file, experiment, simulation, points)
        _check_begin(file, measures, last)
        check_coupling(file, opened, simulation, points, fixed)
        units = _units(opened, points, measures, record)
        fmus = {name: fmu.generation_tool for name, fmu in opened.components.items() if isinstance(fmu, FmuComponent)}
    for step in steps:
        with open_system(system, step):  # whether the components' own steps are multiples of it
            pass
    _check_columns(file, points, measures, record)
    contents = [str(system), *([simulation.input_file] if simulation.input_file else [])]
    files = {name: _content(name) for name in contents}
    return Study(path.stem, str(system), simulation, fixed, points, measures, record, units, fmus, files)


def _simulation(section: TomlTable, folder: Path) -> Simulation:
    section.only([entry.name for entry in fields(Simulation)])
    schemes = one_of("scheme", map(repr, SCHEMES))
    scheme = section.get("scheme", str, "jacobi", schemes)
    if scheme not in SCHEMES:
        raise section.wrong("scheme", schemes, scheme, nearest(scheme, SCHEMES))
    times = {
        name: section.number(name, None, "a number of seconds")
        for name in ("start_time", "stop_time", STEP_SIZE, "output_interval")
    }
    order = section.names("order", None, "a list of components")
    file = section.path("input_file", None, "the path of a CSV file")
    tolerance = section.number("tolerance", None, "a number > 0")
    if tolerance is not None and not tolerance > 0.0:
        raise section.wrong("tolerance", "a number > 0", tolerance)
    return Simulation(
        **times,
        tolerance=tolerance,
        strict=section.get("strict", bool, False, "true or false"),
        scheme=scheme,
        order=None if order is None else tuple(order),
        input_file=None if file is None else str(folder / file),
    )


def _check_points(file: TomlTable, simulation: Simulation, points: Points, fixed: Mapping[str, Value]) -> None:
    if not points.names:
        received = "none of them"
        expected = one_of("table", (f"[{kind}]" for kind in KINDS))
        raise UsageError.report(file.where, expected=expected, received=received)
    seen: set[str] = set(fixed)
    for name in points.names:
        if name in seen:
            raise UsageError.report(file.where, expected=f"{name} in one place", received="two that set it")
        seen.add(name)
    if STEP_SIZE in points.names and simulation.step_size is not None:
        received = "one in [simulation] and values that vary"
        raise UsageError.report(file.where, expected=f"{STEP_SIZE} in one place", received=received)
    if STEP_SIZE in fixed:
        raise UsageError.report(file.where, expected=f"{STEP_SIZE} in [simulation]", received=f"{STEP_SIZE} in [fixed]")


def _measures(section: TomlTable, resolve: Callable[[str, Any], str]) -> Iterator[tuple[str, Measure]]:
    for name in section.entries:
        entry = section.section(name)
        entry.only([each.name for each in fields(Measure)])
        take = entry.get("take", str, ..., one_of("measure", TAKES))
        if take not in TAKES:
            raise entry.wrong("take", one_of("measure", TAKES, take), take, nearest(take, TAKES))
        of, minus = entry.get("of", str, ..., "a signal"), entry.get("minus", str, None, "a signal")
        yield (
            name,
            Measure(
                resolve(f"measure {name}", of),
                take,
                None if minus is None else resolve(f"measure {name}", minus),
                entry.number("after", None, "a number of seconds"),
                _share(entry),
            ),
        )


def _share(entry: TomlTable) -> float:
    within: float = entry.number("within", 0.02)
    if not within > 0:
        raise entry.wrong("within", "a positive share", within)
    return within


def _fixed(section: TomlTable) -> Iterator[tuple[str, Value]]:
    for name, value in flat(section.entries):
        if not isinstance(value, bool | int | float | str):
            likely = "values that vary belong in [grid] or [list]"
            raise section.wrong(name, "one number, text, true or false", value, likely)
        if isinstance(value, float) and not math.isfinite(value):
            raise section.wrong(name, "a finite number", value)
        yield name, value


def _check_begin(file: TomlTable, measures: Mapping[str, Measure], last: float) -> None:
    for name, measure in measures.items():
        if measure.after is not None and measure.after > last + 1e-12:
            where = f"{file.where}, [measures], [{name}], after"
            raise UsageError.report(
                where, expected=f"a time up to the last row, {last!r} s", received=f"{measure.after!r} s"
            )


def _units(system: System, points: Points, measures: Mapping[str, Measure], record: tuple[str, ...]) -> dict[str, str]:
    found = {name: "s" if name == STEP_SIZE else unit_of_name(system, name) for name in (*points.names, *record)}
    found |= {name: "s" if m.take == SETTLING_TIME else unit_of_name(system, m.of) for name, m in measures.items()}
    return {name: unit for name, unit in found.items() if unit}


def _check_columns(file: TomlTable, points: Points, measures: Mapping[str, Measure], record: tuple[str, ...]) -> None:
    seen = {*RESERVED}
    for where, names in (
        ("parameters", points.names),
        ("[measures]", measures),
        ("record", [over_time(name) for name in record]),
    ):
        for name in names:
            if name in seen:
                likely = "the table of results has a column of that name"
                raise UsageError.report(
                    f"{file.where}, {where}", expected="a new name", received=repr(name), likely=likely
                )
            seen.add(name)


def _content(name: str) -> bytes:
    try:
        return Path(name).read_bytes()
    except OSError as error:
        raise UsageError.report(name, expected="a file that can be read", received=str(error)) from error
