"""The named parameters of a log, in the class of disturbances in which they are told best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ndob_fmu.log.fit.class_fit import ClassFit, fit_class
from ndob_fmu.log.fit.orders import ORDERS, SURE
from ndob_fmu.log.fit.parameter_step import least_disturbance, least_near, most_likely
from ndob_fmu.log.fit.problem import Problem
from ndob_fmu.log.fit.setup import Run, Setup
from ndob_fmu.log.told import Told
from ndob_fmu.runtime.equations import HIGHEST_ORDER
from ndob_fmu.support.progress import begin

# A parameter whose standard deviation the log does not lower by this factor is not told by it.
_NOT_TOLD = 0.5
# Fitted parameters that leave a disturbance larger by this factor stand for something else that the model lacks: on
# made logs of right models (`benchmarks/fit_logs.py`) it is up to 1.14, on the measured record of EMPS 2.6. Where it is
# so much larger on the way there, it will not fall again.
_LARGER, _FAR_LARGER = 1.2, 2.0
# Outputs contradict the parameters that leave the least disturbance where the likelihood is less by more than this than
# with the parameters as told.
_CONTRADICTED = 10.0


@dataclass(frozen=True)
class _Found:
    """The parameters that the log tells in a class, and the fit with them.

    lacks_more: whether they are those that leave the least disturbance
    """

    parameters: Mapping[str, Told]
    fit: ClassFit
    warnings: tuple[str, ...]
    lacks_more: bool


def with_parameters(
    setup: Setup, run: Run, known: ClassFit, warnings: list[str]
) -> tuple[Mapping[str, Told], ClassFit]:
    """Return the parameters that the log tells, and the fit with them in the class that was found.

    What a class does not expect of a disturbance, it explains by wrong parameters, as far as the plant follows the
    disturbance. So the parameters are those of a class with one order more, where that is more likely.
    """
    if not setup.free:
        return {}, known
    begin(f"fitting, part 4 of 5: {', '.join(setup.free)}")
    found = best = _in_class(setup, run, known)
    near = setup.with_values({name: one.value for name, one in found.parameters.items()})
    richer = None if found.lacks_more else _with_more_orders(near, run, found.fit)
    if richer is not None:
        best = _in_class(near, run, richer)
    warnings += best.warnings
    if best is found or not best.parameters:
        return found.parameters, found.fit
    problem = replace(setup.with_values(as_told(best.parameters)), free=()).problem(run, known.order)
    return best.parameters, fit_class(problem, best.fit.in_layout_of(problem), most_likely, start=found.fit)


def _with_more_orders(setup: Setup, run: Run, known: ClassFit) -> ClassFit | None:
    """Return the fit in a class with one order more, None where that is no better or was tried before."""
    order = known.order + 1
    if order in ORDERS or order > HIGHEST_ORDER:
        return None
    problem = replace(setup, free=()).problem(run, order)
    fit = fit_class(problem, known.in_layout_of(problem), most_likely)
    return fit if fit.noise.value > known.noise.value + SURE else None


def as_told(parameters: Mapping[str, Told]) -> dict[str, float]:
    """Return values of parameters and of their standard deviations."""
    return {
        key: number for name, one in parameters.items() for key, number in ((name, one.value), (f"{name}_std", one.std))
    }


def _in_class(setup: Setup, run: Run, known: ClassFit) -> _Found:
    """Return the parameters that the log tells in the class of a fit."""
    lacks_more, warnings, unlikely, asked = False, list[str](), list[str](), setup
    while setup.free:
        problem = setup.problem(run, known.order)
        fit = _least(problem, known) if lacks_more else _most_likely(problem, known)
        if not lacks_more and (more := _leaves_more(setup, run, fit, known)):
            least = _least(problem, known)
            if _is_contradicted(least, known):
                name = setup.free[int(np.argmax(np.diag(fit.covariance) / problem.parameter_std**2))]
                warnings.append(f"{name}: {more}; what it does looks like the disturbance, and {_stays(setup, name)}")
                setup, asked = _without(setup, {name}), _without(asked, {name})
                continue
            if unlikely:
                # What the likelihood does not tell, the least disturbance may.
                of_all = _least(asked.problem(run, known.order), known)
                if not _is_contradicted(of_all, known):
                    setup, least, unlikely = asked, of_all, []
            warnings.append(
                f"{', '.join(setup.free)}: {more}; the model lacks something else, and the values that leave least "
                "are taken"
            )
            fit, lacks_more = least, True
        untold = {name for name, one in zip(setup.free, _told(fit), strict=True) if not one}
        if not untold:
            std = np.sqrt(np.diag(fit.covariance)).tolist()
            parameters = map(Told, fit.parameters.tolist(), std)
            found = dict(zip(setup.free, parameters, strict=True))
            return _Found(found, fit, (*warnings, *unlikely), lacks_more)
        disturbances = " or ".join(setup.equations.disturbances)
        unlikely += [
            f"{name}: the log cannot tell it from {disturbances}; {_stays(setup, name)}"
            for name in setup.free
            if name in untold
        ]
        setup = _without(setup, untold)
    return _Found({}, known, (*warnings, *unlikely), lacks_more)


def _most_likely(problem: Problem, known: ClassFit) -> ClassFit:
    """Return the fit with the most likely parameters, or with some on the way there that leave far more disturbance."""
    most_rms = _FAR_LARGER * known.disturbance_rms
    return fit_class(problem, known.in_layout_of(problem), most_likely, start=known, most_rms=most_rms)


def _least(problem: Problem, known: ClassFit) -> ClassFit:
    """Return the fit with the parameters that leave the least disturbance."""
    return fit_class(problem, known.in_layout_of(problem), least_disturbance, start=known, climbs=False)


def _is_contradicted(fit: ClassFit, known: ClassFit) -> bool:
    """Return whether an output contradicts parameters that leave the least disturbance."""
    return fit.noise.value < known.noise.value - _CONTRADICTED


def _leaves_more(setup: Setup, run: Run, fit: ClassFit, known: ClassFit) -> str:
    """Return by how much larger a disturbance all parameters near the most likely ones leave than those told, in words.

    "" where they do not.
    """
    if not any(_told(fit)) or not _larger(fit, known):
        return ""
    near = least_near(fit.problem, fit.trajectory, fit.parameters, fit.noise, fit.covariance)
    told = dict(zip(setup.free, near.tolist(), strict=True))
    problem = replace(setup.with_values(told), free=()).problem(run, known.order)
    return _larger(fit_class(problem, fit.in_layout_of(problem), most_likely, start=fit), known) and _larger(fit, known)


def _larger(fit: ClassFit, known: ClassFit) -> str:
    """Return by how much larger the disturbance of a fit is than that of another, in words; "" where it is not."""
    for more, less, where in (
        (fit.disturbance_rms, known.disturbance_rms, ""),
        (fit.usual_rms, known.usual_rms, " outside of pulses"),
    ):
        if more > _LARGER * less:
            return f"more likely values leave a disturbance of {more:.3g} RMS{where}, those told {less:.3g}"
    return ""


def _stays(setup: Setup, name: str) -> str:
    """Return what is said of a parameter that stays as told."""
    if setup.values[f"{name}_std"]:
        return f"it stays as told, and {name}_std tells the error bars how far off it may be"
    return f"it stays as told, and the error bars take it for known until {name}_std says how far off it may be"


def _without(setup: Setup, names: set[str]) -> Setup:
    return replace(setup, free=tuple(name for name in setup.free if name not in names))


def _told(fit: ClassFit) -> list[bool]:
    """Return of each free parameter whether the log tells it."""
    return [bool(one) for one in np.sqrt(np.diag(fit.covariance)) <= _NOT_TOLD * fit.problem.parameter_std]
