"""Reading an FMU's model description, without unpacking or loading the FMU."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fmpy.model_description import read_model_description

from ndob_fmu.cosim.component import Variable
from ndob_fmu.cosim.default_experiment import DefaultExperiment
from ndob_fmu.cosim.fmi.zip_archive import open_archive
from ndob_fmu.cosim.values import convert, finite_number
from ndob_fmu.errors import CouplingError, some_of
from ndob_fmu.support.units import BASE_UNITS, BaseUnit


@dataclass(frozen=True)
class ModelDescription:
    """The part of ``modelDescription.xml`` that the master uses.

    references: value reference of each variable.
    generation_tool: what made the FMU; empty where it does not say.
    """

    guid: str
    model_identifier: str
    variables: tuple[Variable, ...]
    references: dict[str, int]
    experiment: DefaultExperiment
    generation_tool: str


def read_description(path: Path) -> ModelDescription:
    """Read the model description of an FMI 2.0 co-simulation FMU.

    Raises UsageError if there is no such file, CouplingError if it is not such an FMU.
    """
    expected = "an FMU for FMI 2.0 co-simulation"
    with open_archive(path) as archive:
        if "modelDescription.xml" not in archive.namelist():
            raise CouplingError.report(str(path), expected=expected, received="an archive without modelDescription.xml")
        xml = archive.read_xml("modelDescription.xml")
    try:
        root = ElementTree.fromstring(xml)
        if root.get("fmiVersion") != "2.0" or root.find("CoSimulation") is None:
            raise CouplingError.report(str(path), expected=expected, received=f"one for {_kind(root)}")
        with path.open("rb") as file:  # given a path, fmpy leaves the file open when it fails
            # Not validated against the schema: common exporters fail it in ways that do not matter for a run.
            model = read_model_description(file, validate=False)
    except CouplingError:
        raise
    except Exception as error:  # fmpy raises plain Exception, and does not catch the errors of its parser
        received = str(error).partition("\n")[0] or repr(error)
        raise CouplingError.report(str(path), expected="a readable modelDescription.xml", received=received) from error
    return ModelDescription(
        model.guid,
        model.coSimulation.modelIdentifier,
        _variables(model, path),
        {entry.name: entry.valueReference for entry in model.modelVariables},
        _experiment(model.defaultExperiment, path),
        model.generationTool or "",
    )


def _kind(root: ElementTree.Element) -> str:
    """Return what an FMU of another kind is for, as "FMI 3.0 model exchange and co-simulation"."""
    version = root.get("fmiVersion", "of unknown version")
    if version == "1.0":
        return f"FMI 1.0 {'model exchange' if root.find('Implementation') is None else 'co-simulation'}"
    interfaces = {
        "ModelExchange": "model exchange",
        "CoSimulation": "co-simulation",
        "ScheduledExecution": "scheduled execution",
    }
    found = [words for tag, words in interfaces.items() if root.find(tag) is not None]
    return f"FMI {version} {some_of(found, between=' and ')}" if found else f"FMI {version} without an interface"


def _variables(model: Any, path: Path) -> tuple[Variable, ...]:
    shown, shown_initially = (
        {u.variable.name: u for u in unknowns} for unknowns in (model.outputs, model.initialUnknowns)
    )
    units = {unit.name: _base_unit(unit.baseUnit) for unit in model.unitDefinitions}
    found = []
    for entry in model.modelVariables:
        variable = _variable(entry, path)
        variable = replace(variable, base_unit=units.get(variable.unit))
        if entry.causality == "output":
            # FMI 2.0, section 2.2.8: an output that keeps its start value during initialization is not listed there.
            exact = entry.initial == "exact" and entry.name not in shown_initially
            variable = replace(
                variable,
                dependencies=_dependencies(shown.get(entry.name)),
                initial_dependencies=() if exact else _dependencies(shown_initially.get(entry.name)),
            )
        found.append(variable)
    return tuple(found)


def _dependencies(unknown: Any) -> tuple[str, ...] | None:
    if unknown is None or unknown.dependencies is None:
        return None
    return tuple(known.name for known in unknown.dependencies if known.causality == "input")


def _variable(entry: Any, path: Path) -> Variable:
    variable = Variable(
        entry.name,
        entry.causality,
        entry.type,
        entry.unit or (entry.declaredType.unit if entry.declaredType else None),
        None,
        # FMI 2.0, section 2.2.7: only these may be set before initialization.
        entry.variability != "constant" and (entry.causality == "input" or entry.initial in ("exact", "approx")),
        entry.variability or "continuous",
    )
    if entry.type == "Enumeration" and entry.declaredType:
        variable = replace(variable, items=tuple((item.name, int(item.value)) for item in entry.declaredType.items))
    if entry.start is None:
        return variable
    return replace(variable, start=convert(variable, entry.start, f"{path}, start value of {entry.name}"))


def _base_unit(entry: Any) -> BaseUnit | None:
    if entry is None:
        return None
    return BaseUnit(
        tuple(int(getattr(entry, name) or 0) for name in BASE_UNITS),
        1.0 if entry.factor is None else float(entry.factor),
        0.0 if entry.offset is None else float(entry.offset),
    )


def _experiment(entry: Any, path: Path) -> DefaultExperiment:
    if entry is None:
        return DefaultExperiment()
    start, stop, step, tolerance = (
        finite_number(f"{path}, {name} of DefaultExperiment", getattr(entry, name))
        for name in ("startTime", "stopTime", "stepSize", "tolerance")
    )
    # Some exporters write a tolerance of zero where there is none.
    return DefaultExperiment(start, stop, step, tolerance if tolerance and tolerance > 0 else None)
