"""The fast path: a step with a frozen gain and a sample that is not suspicious, in generated scalar code."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from operator import ge

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.step_designs import StepDesign, squared_norms
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Vector
from ndob_fmu.runtime.generated_steps import ConvergedGain, Numbers, ObserverStepFunction
from ndob_fmu.runtime.numerics.transition import transition
from ndob_fmu.runtime.step.error_columns import joined
from ndob_fmu.runtime.step.faulty_samples import SUSPICIOUS
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory
from ndob_fmu.runtime.step.jump_bank import AFTER_JUMPS, LENGTH, full_bank
from ndob_fmu.runtime.step.measurement_update import Measured
from ndob_fmu.runtime.step.observer import numbers
from ndob_fmu.runtime.step.sensor_memory import MOST

# The gain is frozen once no standard deviation exceeds the converged one by this part.
_CONVERGED = 0.02
# So many steps of about one length that use all samples come before. Where one sensor is slow, its samples seldom
# follow one another, and the covariance rises between them.
STEADY = 3
# A gain serves steps that differ from its own by up to this part. The estimate loses less than 1 %, because the loss is
# of second order.
_JITTER = 0.2
# Moving averages of the squared innovations, over their variance, with which a gain is and stays frozen.
_LEAST_SQUARES, _MOST_SQUARES = 0.05, 2.0


@dataclass(frozen=True)
class ConvergedStep:
    """What all steps of one length H (s) have in common once the gain is frozen.

    tuned_at: the step that the intensities are tuned for (s)
    noise (p,): factors on the variances of the samples that the gain is for
    least_squares (p,): as `least_squares`
    design: of the gain
    observer_step, constants, gain: the generated step, and what it takes besides the state, inputs and H
    M_H (q2,p): d̂ = M_H e for r = 0, None for r ≥ 1
    """

    H: float
    tuned_at: float
    noise: tuple[float, ...]
    least_squares: tuple[float, ...]
    design: StepDesign = field(repr=False)
    observer_step: ObserverStepFunction = field(repr=False)
    constants: Numbers = field(repr=False)
    gain: ConvergedGain = field(repr=False)
    M_H: tuple[Numbers, ...] | None


def converged_step(
    model: FilterModel, design: StepDesign, tuned_at: float, noise: tuple[float, ...]
) -> ConvergedStep | None:
    """Return the fast path of a design; None where the generated code cannot be evaluated at the parameters."""
    equations = model.equations
    try:
        constants = equations.steps.observer_constants(model.parameters)
    except (ArithmeticError, ValueError):
        return None
    stationary = design.stationary
    n, q = stationary.system.linear.G_d.shape
    missing = n + HIGHEST_ORDER * q - len(stationary.K)
    K = np.vstack([stationary.K, np.zeros((missing, stationary.K.shape[1]))])
    expected = residual_std(design)
    ahead, at_sample = disturbance_std(design)
    return ConvergedStep(
        H=design.H,
        tuned_at=tuned_at,
        noise=noise,
        least_squares=least_squares(model, noise, design),
        design=design,
        observer_step=equations.steps.observer_step,
        constants=constants,
        gain=ConvergedGain(
            gate=numbers(SUSPICIOUS * expected),
            weight=numbers(1.0 / expected**2),
            d_std=numbers(ahead),
            at_sample_std=numbers(at_sample),
            residual_std=numbers(expected),
            K=numbers(K.ravel()),
        ),
        M_H=None if stationary.M_H is None else tuple(tuple(row.tolist()) for row in stationary.M_H),
    )


def residual_std(design: StepDesign) -> Array:
    """Return the standard deviation (p,) of a residual with the frozen gain."""
    return np.asarray(
        np.minimum(np.linalg.norm(design.stationary.update.innovation_factor, axis=1), design.residual_std)
    )


def disturbance_std(design: StepDesign) -> tuple[Array, Array]:
    """Return the error bars (q2,) of d̂ with the frozen gain, a step ahead and at the sample."""
    stationary, bound = design.stationary, design.known.disturbance_bound
    selector = stationary.system.selector
    if selector is None:
        steady = np.minimum(design.disturbance_std, bound)
        return steady, steady
    ahead = np.linalg.norm(selector @ stationary.prior_factor, axis=1)
    at_sample = np.linalg.norm(selector @ stationary.update.factor, axis=1)
    # The white noise that stands for the disturbance counts for more than a disturbance within its bounds can do.
    share = np.minimum(design.disturbance_std / ahead, 1.0)
    return np.minimum(share * ahead, bound), np.minimum(share * at_sample, bound)


def least_squares(model: FilterModel, noise: Vector, design: StepDesign) -> tuple[float, ...]:
    """Return averages (p,) of squared innovations over their variance, below which the noise should adapt.

    noise (p,): factors on the variances of the samples in the design. The average is 0 where they are the least
    possible, or too small a part of the innovations to become smaller.
    """
    stationary = design.stationary
    alpha, R = squared_norms(stationary.update.innovation_factor), squared_norms(stationary.sample_factor)
    return tuple(
        _LEAST_SQUARES if model.adapts and used > smallest and can else 0.0
        for used, smallest, can in zip(noise, model.least_noise.tolist(), (MOST * alpha <= R).tolist(), strict=True)
    )


def squares_are_usual(squares: Numbers, least: Vector) -> bool:
    """Return whether innovations are as large as with the frozen gain they should be; least (p,): `least_squares`."""
    return max(squares) <= _MOST_SQUARES and all(map(ge, squares, least))


def is_quiet(measured: Measured, least: Vector) -> bool:
    """Return whether all samples of a step were used and usual; least (p,): `least_squares`."""
    quiet = not measured.suspicious and measured.mixture.shift is None and all(measured.used)
    return quiet and squares_are_usual(measured.squares, least)


def is_near(step: float, H: float) -> bool:
    """Return whether a gain for a step (s) serves one of H (s), as where the times of samples jitter."""
    return abs(H - step) <= _JITTER * step


def steady_after(memory: FilterMemory, measured: Measured, H: float) -> int:
    """Return how many steps in a row had about one length and used all samples, after one more of H (s)."""
    alike = is_near(memory.step, H) or is_near(memory.tuned_at, H)
    return min(memory.steady + 1, STEADY) if alike and all(measured.used) else 0


def has_converged(memory: FilterMemory, design: StepDesign) -> bool:
    """Return whether the gain of a design may replace that of the covariance, after a quiet step."""
    now = squared_norms(design.judged @ memory.columns.factor)
    return bool((now <= design.judged_variances * (1.0 + _CONVERGED) ** 2).all())


def frozen_memory(
    model: FilterModel, memory: FilterMemory, design: StepDesign, noise: tuple[float, ...]
) -> FilterMemory:
    """Return the memory that stays the same while the gain is frozen for noise (p,)."""
    stationary = design.stationary
    memory = replace(memory, converged=True, frozen_noise=noise, step=design.H)
    if stationary.system.order == 0:
        return replace(memory, columns=memory.columns.with_factor(stationary.prior_factor))
    spacing = max(1, round(model.jump_spacing / design.H))
    signatures = []
    A, units = stationary.system.A, stationary.system.units
    responses = transition(A, np.zeros((len(A), 0)), design.H, model.jump_channel, AFTER_JUMPS, units).responses
    mu = model.signatures_in_step(responses)
    for age in range(LENGTH * spacing):
        if age % spacing == 0:
            signatures.append(mu)
        mu = stationary.discrete.Phi @ (mu - stationary.K @ (stationary.system.C @ mu))
    columns = joined(stationary.prior_factor, np.hstack(signatures[::-1]), memory.columns.covariance)
    return replace(memory, columns=columns, jumps=full_bank(model.bound, memory.jumps.rate))
