"""The fast path: a step with a converged gain and a sample inside the gate, in generated scalar code."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.runtime.design.start_up import StartUp
from ndob_fmu.runtime.design.step_designs import StepDesign
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector
from ndob_fmu.runtime.generated_steps import ConvergedGain, Numbers, ObserverStepFunction
from ndob_fmu.runtime.step.error_bars import disturbance_std, residual_std
from ndob_fmu.runtime.step.gate import gate
from ndob_fmu.runtime.step.observer import numbers
from ndob_fmu.runtime.step.sampled_observer_state import CovarianceState


@dataclass(frozen=True)
class ConvergedStep:
    """What all steps of one length H (s) have in common once the gain has converged.

    observer_step, constants, gain: the generated step, and what it takes besides the state, inputs and H.
    M_H (q2,p): d̂ = M_H e for r = 0, None for r ≥ 1.
    covariance: the converged one.
    """

    H: float
    observer_step: ObserverStepFunction = field(repr=False)
    constants: Numbers = field(repr=False)
    gain: ConvergedGain = field(repr=False)
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
        gain=ConvergedGain(
            gate=numbers(largest), d_std=covariance.d_std, residual_std=numbers(expected), K=numbers(K.ravel())
        ),
        M_H=None if stationary.M_H is None else tuple(map(tuple, stationary.M_H.tolist())),
        covariance=covariance,
    )
