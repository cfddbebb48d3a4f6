"""The named parameters of a log, in the class of disturbances in which they are told best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ndob_fmu.log.fit.class_fit import ClassFit, fit_class
from ndob_fmu.log.fit.parameter_step import least_disturbance, most_likely
from ndob_fmu.log.fit.setup import Run, Setup
from ndob_fmu.log.told import Told
from ndob_fmu.runtime.equations import HIGHEST_ORDER
from ndob_fmu.support.progress import begin

# Orders of the disturbance that an observer is proposed for.
ORDERS = (1, 2)
# A gain of the log-likelihood that is worth another order.
SURE = 2.0
# A parameter whose standard deviation the log does not lower by this factor is not told by it.
_NOT_TOLD = 0.5
# Fitted parameters that leave a disturbance larger by this factor stand for something else that the model lacks: on
# made logs of right models (`benchmarks/fit_logs.py`) it is up to 1.14, on the measured record of EMPS 2.6. Where it is
# so much larger on the way there, it will not fall again.
_LARGER, _FAR_LARGER = 1.2, 2.0


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
    lacks_more, warnings = False, list[str]()
    while setup.free:
        problem = setup.problem(run, known.order)
        if not lacks_more:
            most_rms = _FAR_LARGER * known.disturbance_rms
            fit = fit_class(problem, known.in_layout_of(problem), most_likely, start=known, most_rms=most_rms)
            told = _told(fit)
            lacks_more = any(told) and fit.disturbance_rms > _LARGER * known.disturbance_rms
            if lacks_more:
                warnings.append(
                    f"{', '.join(setup.free)}: more likely values leave a disturbance of {fit.disturbance_rms:.3g} "
                    f"RMS, those told {known.disturbance_rms:.3g}; the model lacks something else, and the values that "
                    "leave least are taken"
                )
        if lacks_more:
            fit = fit_class(problem, known.in_layout_of(problem), least_disturbance, start=known, climbs=False)
            told = _told(fit)
        warnings += [
            f"{name}: the log cannot tell it from {' or '.join(setup.equations.disturbances)}; it stays as told, and "
            f"{name}_std tells the error bars how far off it may be"
            for name, one in zip(setup.free, told, strict=True)
            if not one
        ]
        if all(told):
            std = np.sqrt(np.diag(fit.covariance)).tolist()
            parameters = map(Told, fit.parameters.tolist(), std)
            return _Found(dict(zip(setup.free, parameters, strict=True)), fit, tuple(warnings), lacks_more)
        setup = replace(setup, free=tuple(name for name, one in zip(setup.free, told, strict=True) if one))
    return _Found({}, known, tuple(warnings), lacks_more)


def _told(fit: ClassFit) -> list[bool]:
    """Return of each free parameter whether the log tells it."""
    return [bool(one) for one in np.sqrt(np.diag(fit.covariance)) <= _NOT_TOLD * fit.problem.parameter_std]
