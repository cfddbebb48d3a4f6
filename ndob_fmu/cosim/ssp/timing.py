"""The default experiment of a package, and step sizes in annotations of the Open Simulation Platform."""

from __future__ import annotations

from ndob_fmu.cosim.default_experiment import DefaultExperiment
from ndob_fmu.cosim.ssp.schema import Element, child, children, local_name
from ndob_fmu.cosim.ssp.structure import components
from ndob_fmu.cosim.values import finite_number
from ndob_fmu.errors import UsageError

_OSP = "com.opensimulationplatform"
_ROUNDING = 1e-6  # of a ratio: two step sizes, each rounded to the digits of a file


def read_experiment(where: str, root: Element) -> DefaultExperiment:
    """Return start and stop time, and the step size from the annotation of the Open Simulation Platform.

    Raises CouplingError if one of them is not a finite number.
    """
    experiment = child(root, "ssd:DefaultExperiment")
    if experiment is None:
        return DefaultExperiment()
    algorithm = _annotated(experiment, "FixedStepAlgorithm")
    return DefaultExperiment(
        _seconds(where, experiment, "startTime"),
        _seconds(where, experiment, "stopTime"),
        None if algorithm is None else _seconds(where, algorithm, "baseStepSize"),
    )


def read_step_ratios(where: str, system: Element, step_size: float | None) -> dict[str, int]:
    """Return the components that have a step size of their own, in communication steps of `step_size` (s).

    Raises UsageError where that is not a whole number.
    """
    ratios = {}
    for name, element in components(system):
        hint = _annotated(element, "StepSizeHint")
        own = None if hint is None else _seconds(where, hint, "value")
        if own is None or step_size is None or not step_size > 0.0:
            continue
        ratio = round(own / step_size)
        if ratio < 1 or abs(own / step_size - ratio) > _ROUNDING * ratio:
            raise UsageError.report(
                f"{where}, step size of {name}",
                expected=f"a whole multiple of the communication step, {step_size:g} s",
                received=f"{own:g} s",
                likely="the communication step must divide the step of every component",
            )
        if ratio > 1:
            ratios[name] = ratio
    return ratios


def _annotated(element: Element, name: str) -> Element | None:
    for annotation in children(element, "ssd:Annotations/ssc:Annotation"):
        if annotation.get("type") == _OSP:
            for found in annotation.iter("*"):
                if local_name(found) == name:
                    return found
    return None


def _seconds(where: str, element: Element, attribute: str) -> float | None:
    return finite_number(f"{where}, {attribute}", element.get(attribute), "a finite number of seconds")
