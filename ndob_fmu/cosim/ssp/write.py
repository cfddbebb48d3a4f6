"""Writing a System of FMUs as a package, in the form that libcosim, ecos, OMSimulator and fmpy all read.

In this form each connection goes from component to component, conversions of units are written as transformations, and
each component has one parameter set with plain variable names; all sets have the same name. Names at the system's
boundary go beyond it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from ndob_fmu.cosim.component import Value, Variable
from ndob_fmu.cosim.default_experiment import DefaultExperiment
from ndob_fmu.cosim.fmi.fmu_component import FmuComponent
from ndob_fmu.cosim.ssp import markup
from ndob_fmu.cosim.ssp.file_names import FileNames, plain
from ndob_fmu.cosim.ssp.markup import TOOLS, add, annotate, file_text, tag
from ndob_fmu.cosim.ssp.pack import Restart, as_built, write_package
from ndob_fmu.cosim.ssp.schema import SSD_NAME, Element
from ndob_fmu.cosim.ssp.supported import FMU_TYPE
from ndob_fmu.cosim.ssp.value_elements import UsedUnits, add_transformation, literal, written_type
from ndob_fmu.cosim.system.ports import AS_IT_IS, Link, Port
from ndob_fmu.cosim.system.system import System
from ndob_fmu.cosim.system.wiring import keep_start_values, undriven_inputs
from ndob_fmu.cosim.values import convert
from ndob_fmu.errors import CouplingError, UsageError

_log = logging.getLogger(__name__)


def write_system(
    system: System,
    path: Path,
    experiment: DefaultExperiment,
    parameter_set: str,
    description: str,
    restart: Restart = as_built,
) -> Path:
    """Write the package; `ndob_fmu.write_ssp` documents arguments and errors."""
    if path.suffix != ".ssp":
        raise UsageError.report(str(path), expected="the path of an .ssp", received=repr(path.suffix))
    files = description_files(system, path.stem, experiment, parameter_set, description)
    fmus = _fmus(system)
    files |= {entry: fmus[name].read_bytes() for name, entry in _entries(fmus).items()}
    return write_package(path, files, restart)


def description_files(
    system: System, name: str, experiment: DefaultExperiment, parameter_set: str, description: str
) -> dict[str, bytes]:
    """Return the XML files of the package by their names.

    Raises CouplingError for a component that is not an FMU, and a name at the boundary whose variables start with
    values that contradict it; UsageError for step ratios without a step size.
    """
    exposed = {link.port for links in system.inputs.values() for link in links}
    undriven = undriven_inputs(system, exposed)
    if undriven:
        _log.warning("%s", keep_start_values(undriven))
        system = _with_own_starts(system, map(system.port, undriven))
    return _Writer(system, name, parameter_set).files(experiment, description, exposed)


def _with_own_starts(system: System, ports: Iterable[Port]) -> System:
    """Return the system with the start values of its FMUs, which the package then states: tools differ without."""
    own = {port: system.variable(port).start for port in ports}
    return replace(system, start_values={**{p: v for p, v in own.items() if v is not None}, **system.start_values})


def _fmus(system: System) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for name, component in system.components.items():
        if not isinstance(component, FmuComponent):
            received = type(component).__name__
            raise CouplingError.report(f"component {name}", expected="an FMU", received=received)
        found[name] = component.path
    return found


def _entries(fmus: Mapping[str, Path]) -> dict[str, str]:
    """Return the name that each component's FMU has in the package.

    Each component has a file of its own, which can have start values of its own. One from a package has its component
    in its name already.
    """
    names = FileNames()
    stems = {name: fmu.stem.removeprefix(f"{plain(name)}_") for name, fmu in fmus.items()}
    return {name: f"resources/{names.new(f'{name}_{stem}', '.fmu')}" for name, stem in stems.items()}


class _Writer:
    """Makes the XML files of one system."""

    def __init__(self, system: System, name: str, parameter_set: str) -> None:
        self._system = system
        self._name = name
        self._set = parameter_set
        self._names = FileNames()
        self._files: dict[str, Element] = {}
        self._units = UsedUnits()

    def files(self, experiment: DefaultExperiment, description: str, exposed: set[Port]) -> dict[str, bytes]:
        """Return the texts of all files."""
        system = self._system
        prefixes = ("ssd", "ssc", "ssv", "ssm", *TOOLS)
        root = markup.root("ssd:SystemStructureDescription", *prefixes, version="1.0", name=self._name)
        if description:
            root.set("description", description)
        top = add(root, "ssd:System", name=self._name)
        self._boundary(top)
        elements = add(top, "ssd:Elements")
        for name, entry in _entries(_fmus(system)).items():
            values = {
                port.variable: value
                for port, value in system.start_values.items()
                if port.component == name and port not in exposed
            }
            self._component(elements, name, entry, values, experiment.step_size)
        self._connections(top)
        if experiment.step_size is not None:
            information = annotate(top, "org.openmodelica", "oms:Annotations", "oms:SimulationInformation")
            times = {
                "stepSize": repr(experiment.step_size),
                "absoluteTolerance": "0.0001",
                "relativeTolerance": "0.0001",
            }
            add(information, "oms:FixedStepMaster", description="oms-ma", **times)
        self._units.define(root, "ssd:Units")
        _experiment(root, experiment)
        return {name: file_text(element) for name, element in {SSD_NAME: root, **self._files}.items()}

    def _component(
        self, elements: Element, name: str, source: str, values: Mapping[str, Value], step_size: float | None
    ) -> None:
        system = self._system
        # The type is SSP's default; OMSimulator passes over components without it.
        kind = {"type": FMU_TYPE, "implementation": "CoSimulation"}
        element = add(elements, "ssd:Component", name=name, source=source, **kind)
        used = {port.variable for c in system.connections for port in c[:2] if port.component == name}
        used |= {link.port.variable for link in system.outputs.values() if link.port.component == name}
        used |= {
            link.port.variable
            for links in system.inputs.values()
            for link in links
            if link.port.component == name and not self._is_mapped(links)
        }
        variables = [v for v in system.components[name].variables if v.name in used]
        self._connectors(element, [(v.name, v.causality, v) for v in variables])
        if values:
            set_of = {variable: (system.variable(Port(name, variable)), value) for variable, value in values.items()}
            self._bind(element, self._parameter_set(name, ".ssv", set_of))
        ratio = system.step_ratios.get(name, 1)
        if ratio > 1:
            if step_size is None:
                raise UsageError.report(
                    "step size", expected=f"a number of seconds, for the step ratio {ratio} of {name}", received="none"
                )
            annotate(element, "com.opensimulationplatform", "osp:StepSizeHint").set("value", repr(ratio * step_size))

    def _boundary(self, top: Element) -> None:
        """Write what the system shows: connectors, their start values, and mappings of shared parameters."""
        system = self._system
        kinds: list[tuple[str, str, Variable]] = []
        single: dict[str, tuple[Variable, Value]] = {}
        shared: dict[str, tuple[Variable, Value]] = {}
        for name, links in system.inputs.items():
            variable, value = self._start(name, links)
            if self._is_mapped(links):
                shared[name] = (variable, value)
                continue
            inputs = all(system.variable(link.port).causality == "input" for link in links)
            kinds.append((name, "input" if inputs else "parameter", variable))
            single[name] = (variable, value)
        kinds += [(name, "output", self._seen(link)) for name, link in system.outputs.items()]
        self._connectors(top, kinds)
        if single:
            self._bind(top, self._parameter_set(self._name, ".boundary.ssv", single))
        if shared:
            binding = self._bind(top, self._parameter_set(self._name, ".parameters.ssv", shared))
            add(binding, "ssd:ParameterMapping", source=self._mapping(shared))

    def _is_mapped(self, links: Iterable[Link]) -> bool:
        """Whether a name at the boundary is one parameter for several: a mapping then says so, no connector."""
        return all(self._system.variable(link.port).causality != "input" for link in links)

    def _seen(self, link: Link) -> Variable:
        variable = self._system.variable(link.port)
        if link[1:] == AS_IT_IS:
            return variable
        return Variable(variable.name, variable.causality, variable.type)

    def _start(self, name: str, links: tuple[Link, ...]) -> tuple[Variable, Value]:
        """Return a variable like what is at the boundary, and the value with which all behind it start."""
        system, (first, *_) = self._system, links
        given = system.start_values.get(first.port, system.variable(first.port).start)
        if given is None:
            raise CouplingError.report(f"input {name}", expected=f"a start value for {first.port}", received="none")
        value = given if first[1:] == AS_IT_IS else (float(given) - first.offset) / first.factor
        for port, expected in system.starts(name, value).items():
            actual = system.start_values.get(port, expected)
            if convert(system.variable(port), actual, name) != expected and port != first.port:
                raise CouplingError.report(
                    f"start value of {port}", expected=f"{expected}, as {name} says", received=repr(actual)
                )
        return self._seen(first), value

    def _mapping(self, shared: Iterable[str]) -> str:
        root = markup.root("ssm:ParameterMapping", "ssm", "ssc", version="1.0")
        for name in shared:
            for link in self._system.inputs[name]:
                entry = add(root, "ssm:MappingEntry", source=name, target=str(link.port))
                add_transformation(entry, link.factor, link.offset)
        return self._file(self._name, ".parameters.ssm", root)

    def _connectors(self, element: Element, kinds: Iterable[tuple[str, str, Variable]]) -> None:
        kinds = list(kinds)
        connectors = add(element, "ssd:Connectors") if kinds else None
        for name, kind, variable in kinds:
            connector = add(connectors, "ssd:Connector", name=name, kind=kind)
            typed = add(connector, f"ssc:{written_type(variable)}")
            self._units.name_unit(typed, variable)

    def _parameter_set(self, stem: str, suffix: str, values: Mapping[str, tuple[Variable, Value]]) -> str:
        root = markup.root("ssv:ParameterSet", "ssv", "ssc", version="1.0", name=self._set)
        parameters, units = add(root, "ssv:Parameters"), UsedUnits()
        for name, (variable, value) in values.items():
            typed = add(
                add(parameters, "ssv:Parameter", name=name),
                f"ssv:{written_type(variable)}",
                value=literal(variable, value),
            )
            units.name_unit(typed, variable)
        units.define(root, "ssv:Units")
        return self._file(stem, suffix, root)

    def _file(self, stem: str, suffix: str, root: Element) -> str:
        file = self._names.new(stem, suffix)
        self._files[file] = root
        return file

    def _bind(self, element: Element, file: str) -> Element:
        bindings = element.find(tag("ssd:ParameterBindings"))
        if bindings is None:
            bindings = add(element, "ssd:ParameterBindings")
        return add(bindings, "ssd:ParameterBinding", source=file)

    def _connections(self, top: Element) -> None:
        system = self._system
        ends: list[tuple[dict[str, str], float, float]] = []
        for name, links in system.inputs.items():
            for port, factor, offset in () if self._is_mapped(links) else links:
                ends.append(({"startConnector": name} | _port("end", port), factor, offset))
        for source, target, factor, offset, _ in system.connections:
            ends.append((_port("start", source) | _port("end", target), factor, offset))
        for name, (port, factor, offset) in system.outputs.items():
            ends.append((_port("start", port) | {"endConnector": name}, factor, offset))
        connections = add(top, "ssd:Connections") if ends else None
        for attributes, factor, offset in ends:
            add_transformation(add(connections, "ssd:Connection", **attributes), factor, offset)


def _port(end: str, port: Port) -> dict[str, str]:
    return {f"{end}Element": port.component, f"{end}Connector": port.variable}


def _experiment(root: Element, experiment: DefaultExperiment) -> None:
    times = {"startTime": experiment.start_time, "stopTime": experiment.stop_time}
    element = add(root, "ssd:DefaultExperiment", **{k: f"{v!r}" for k, v in times.items() if v is not None})
    if experiment.step_size is not None:
        algorithm = annotate(element, "com.opensimulationplatform", "osp:Algorithm")
        add(algorithm, "osp:FixedStepAlgorithm", baseStepSize=repr(experiment.step_size))
