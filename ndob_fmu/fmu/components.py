"""The component FMUs that fit any plant: one record for each in the folder `component_records`."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from ndob_fmu.fmu import component_records
from ndob_fmu.fmu.record import ComponentRecord


def records() -> tuple[ComponentRecord, ...]:
    """Return all records, in the order of their names."""
    modules = (
        import_module(f"{component_records.__name__}.{each.name}") for each in iter_modules(component_records.__path__)
    )
    found: list[ComponentRecord] = [module.RECORD for module in modules]
    return tuple(sorted(found, key=lambda record: record.name))


def build_components(out: str | Path = "build/fmus") -> tuple[Path, ...]:
    """Write the FMU of each record into the folder `out` and return their paths.

    Raises UsageError where the folder cannot be written.
    """
    return tuple(record.build(out) for record in records())
