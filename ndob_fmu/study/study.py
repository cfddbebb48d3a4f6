"""A study as a value: the system, fixed and varied parameters, and the results that are kept of each run."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ndob_fmu.cosim import Value
from ndob_fmu.study.measures import Measure
from ndob_fmu.study.points import Points

STEP_SIZE = "step_size"


@dataclass(frozen=True)
class Simulation:
    """How each run is simulated: the keywords of `ndob_fmu.simulate`; None is the system's default."""

    start_time: float | None = None
    stop_time: float | None = None
    step_size: float | None = None
    output_interval: float | None = None
    input_file: str | None = None
    scheme: str = "jacobi"
    order: tuple[str, ...] | None = None
    tolerance: float | None = None
    strict: bool = False


@dataclass(frozen=True)
class Study:
    """Many runs of one system. Run k has the start values ``points[k]``.

    system: the path of the .ssp or .fmu.
    simulation: settings of every run.
    fixed: start values of every run, by ``component.variable``.
    points: start values that differ between runs; the name ``step_size`` is the communication step in s.
    measures: the numbers that are kept of each run, by name.
    record: signals whose values over time are kept too.
    units: by name, of points, measures and record that have one.
    fmus: what made the FMU of each component, which tells native FMUs from those in Python.
    files: the content of the system and of the input file, by path. Workers on other machines receive it.
    """

    name: str
    system: str
    simulation: Simulation
    fixed: Mapping[str, Value]
    points: Points
    measures: Mapping[str, Measure]
    record: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    fmus: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return the description of the study in study.json."""
        return {
            "name": self.name,
            "system": Path(self.system).name,
            "fmus": dict(self.fmus),
            "runs": len(self.points),
            "simulation": self._settings(),
            "fixed": dict(self.fixed),
            "varied": self._varied(),
            "measures": {name: _without_none(asdict(measure)) for name, measure in self.measures.items()},
            "record": list(self.record),
            "units": dict(self.units),
        }

    def _settings(self) -> dict[str, Any]:
        settings = asdict(self.simulation)
        return {key: value for key, value in settings.items() if value is not None and value is not False}

    def _varied(self) -> dict[str, Any]:
        drawn = {name for table in self.points.tables if table.drawn for name in table.names}
        return {
            name: {"from": min(levels), "to": max(levels), "values": len(levels)} if name in drawn else levels
            for name, levels in self.points.levels().items()
        }

    @property
    def digest(self) -> str:
        """A digest of everything that the results depend on, except the versions of the software."""
        tables = [[table.names, table.rows] for table in self.points.tables]
        contents = [hashlib.sha256(content).hexdigest() for content in self.files.values()]
        settings = {**self.to_dict(), "name": None, "system": None, "fmus": None, "varied": tables, "files": contents}
        settings["simulation"] = {**settings["simulation"], "input_file": None}
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def _without_none(entries: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in entries.items() if value is not None}
