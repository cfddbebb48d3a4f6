"""The fast path: a step with a converged gain and a sample inside the gate, in generated scalar code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.runtime.design.start_up import StartUp
from ndob_fmu.runtime.design.step_designs import StepDesign
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector
from ndob_fmu.runtime.step.error_bars import disturbance_std, residual_std
from ndob_fmu.runtime.step.gate import gate
from ndob_fmu.runtime.step.observer import numbers
from ndob_fmu.runtime.step.sampled_observer_state import CovarianceState, Numbers


@dataclass(frozen=True)
class ConvergedStep:
    """What all steps of one length H (s) have in common once the gain has converged.

    observer_step: that of `equations.Steps`, with its arguments k = constants and r = frozen.
    M_H (q2,p): d̂ = M_H e for r = 0, None for r ≥ 1.
    covariance: the converged one.
    """

    H: float
    observer_step: Callable[[Vector, Vector, Vector, Vector, float], tuple[Numbers, ...] | None] = field(repr=False)
    constants: Numbers = field(repr=False)
    frozen: Numbers = field(repr=False)
    M_H: tuple[Numbers, ...] | None
    covariance: CovarianceState


def converged_covariance(design: StepDesign, tuned_at: float, start: StartUp) -> CovarianceState:
    """Return the state of the covariance once the gain of a design has converged."""
    factor = design.stationary.prior_factor
    return CovarianceState(
        factor=factor,
        d_std=numbers(disturbance_std(factor, design)),
        converged=True,
        tuned_at=tuned_at,
        waited=0.0,
        rejected=0,
        age=start.samples,
    )


def converged_step(
    equations: Equations, parameters: Vector, design: StepDesign, covariance: CovarianceState
) -> ConvergedStep | None:
    """Return the fast path of a design; None where the generated code cannot be evaluated at the parameters."""
    try:
        constants = equations.steps.observer_constants(parameters)
    except (ArithmeticError, ValueError):
        return None
    stationary = design.stationary
    n, q = stationary.system.linear.G_d.shape
    missing = n + HIGHEST_ORDER * q - len(stationary.K)
    K = np.vstack([stationary.K, np.zeros((missing, stationary.K.shape[1]))])
    largest = gate(stationary.update.innovation_factor, design)
    expected = residual_std(stationary.prior_factor, design)
    return ConvergedStep(
        H=design.H,
        observer_step=equations.steps.observer_step,
        constants=constants,
        frozen=(*largest.tolist(), *covariance.d_std, *numbers(expected), *K.ravel().tolist()),
        M_H=None if stationary.M_H is None else tuple(map(tuple, stationary.M_H.tolist())),
        covariance=covariance,
    )
