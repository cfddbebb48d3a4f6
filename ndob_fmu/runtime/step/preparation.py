"""What follows from an observer's parameters and settings before its first step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.design.augmented import Augmented, augment
from ndob_fmu.runtime.design.doubtful import doubtful_equations
from ndob_fmu.runtime.design.like_disturbance import act_as_disturbance
from ndob_fmu.runtime.design.longest_step import longest_step
from ndob_fmu.runtime.design.minimum_phase import require_zeros_left_of
from ndob_fmu.runtime.design.operating_point import largest_input, middle_input, require_tangent, tangent
from ndob_fmu.runtime.design.stationary_design import StationaryDesign
from ndob_fmu.runtime.design.step_designs import StepDesigns
from ndob_fmu.runtime.design.tuning import Knowledge
from ndob_fmu.runtime.design.undriven_noise import undriven_noise
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.step.layout import Layout
from ndob_fmu.runtime.step.settings import ObserverSettings


@dataclass(frozen=True)
class PreparedObserver:
    """An observer at given parameters, for an estimate x̂₀ to start from.

    layout: of ξ
    noise_std (p,): of the samples, at least their rounding
    rounding (p,): that rounding
    undriven (n,): intensity of the noise on states that nothing else drives, over the step
    doubtful (n,): as `doubtful_equations` returns it; none for r = 0
    like_disturbance: 1 for each uncertain parameter that is considered and acts as d does, else 0
    designs: the stationary design for each step size, with f as noise
    tracking: the same with f's slopes at x̂₀ known
    longest: the longest step (s) that is tried
    """

    equations: Equations
    parameters: Vector
    settings: ObserverSettings
    layout: Layout
    noise_std: Array
    rounding: Array
    undriven: Array
    doubtful: NDArray[np.bool_]
    like_disturbance: Array
    designs: StepDesigns
    tracking: StepDesigns
    longest: float

    @property
    def system(self) -> Augmented:
        """The plant with the disturbance's derivatives as states."""
        return self.designs.system

    @property
    def known(self) -> Knowledge:
        """What is known of noise and disturbance."""
        return self.designs.known

    def design(self, H: float) -> StationaryDesign:
        """Return the stationary design at a step H (s). Raises DesignError where there is none."""
        return self.designs.at(H).stationary


def prepared(equations: Equations, parameters: Vector, settings: ObserverSettings, x_hat: Vector) -> PreparedObserver:
    """Return an observer with settings that `check_settings` has accepted, for an estimate x̂₀ (n,) to start from.

    Raises AssumptionError for a zero right of 0, or of −α for r = 0.
    """
    order = settings.order
    bound, rate, std, noise = (
        np.array(v, dtype=float)
        for v in (settings.disturbance_bound, settings.disturbance_rate, settings.x_std, settings.sensors.noise_std)
    )
    working = linearised(equations, parameters, x_hat, order)
    # For r = 0 the gain is the paper's, with f as an unknown input.
    linear = working if equations.matrices is None else equations.linear_part(parameters)
    if order == 0:
        require_zeros_left_of(linear, settings.alpha)
    else:
        require_zeros_left_of(working, 0.0)
    # No sample is better than the rounding of a number of its size.
    size = np.abs(_output(equations, parameters, x_hat, linear.C)) + np.abs(linear.C) @ std
    rounding = 4.0 * np.finfo(float).eps * size
    noise = np.maximum(noise, rounding)
    known = Knowledge(R_factor=np.diag(noise), disturbance_bound=bound, disturbance_rate=rate)
    u = middle_input(equations.inputs, equations.ranges)
    uncertain = tuple(i for i, s in enumerate(settings.parameter_std) if s > 0.0)
    undriven = _undriven(working, settings, x_hat, np.array(largest_input(equations.inputs, equations.ranges)))
    noisy = np.asarray((np.array(settings.state_noise, dtype=float) + undriven > 0.0) | (order == 0))
    return PreparedObserver(
        equations=equations,
        parameters=parameters,
        settings=settings,
        layout=Layout(
            n=len(linear.A),
            q=linear.G_d.shape[1],
            order=order,
            own=tuple(min(int(own) or order, order) for own in settings.own_order),
            biased=tuple(i for i, s in enumerate(settings.sensors.bias_std) if s > 0.0),
            uncertain=uncertain,
        ),
        noise_std=noise,
        rounding=rounding,
        undriven=undriven,
        doubtful=doubtful_equations(working.A, working.B, working.C, working.G_d, noisy),
        like_disturbance=_like_disturbance(equations, parameters, settings, uncertain, x_hat, u, noise),
        designs=StepDesigns(
            system=augment(linear, order, noise),
            known=known,
            x_std=std,
            alpha=settings.alpha,
            pi=settings.pi,
        ),
        tracking=StepDesigns(
            system=augment(working, order, noise),
            known=known,
            x_std=std,
            alpha=settings.alpha,
            pi=settings.pi,
        ),
        longest=longest_step(equations, linear),
    )


def _like_disturbance(
    equations: Equations,
    parameters: Vector,
    settings: ObserverSettings,
    uncertain: tuple[int, ...],
    x_hat: Vector,
    u: Vector,
    noise: Array,
) -> Array:
    """Return 1 for each uncertain parameter that is considered and acts as d does, else 0."""
    if settings.order == 0 or not uncertain:
        return np.zeros(len(uncertain))
    size = np.concatenate([np.array(settings.x_std, dtype=float), noise])
    act = act_as_disturbance(equations, parameters, uncertain, x_hat, u, size)
    return np.where([settings.estimated[i] for i in uncertain], 0.0, act)


def _undriven(linear: LinearPart, settings: ObserverSettings, x_hat: Vector, u_size: Array) -> Array:
    """Return the intensities (n,) of `undriven_noise`, over the step, with states of the size of x̂₀ or its error.

    u_size (m,): size of the inputs
    """
    if settings.order == 0:
        return np.zeros(len(linear.A))
    noise = np.diag(np.array(settings.state_noise, dtype=float))
    size = np.maximum(np.abs(np.array(x_hat, dtype=float)), np.array(settings.x_std, dtype=float))
    by_input = np.asarray(np.linalg.norm(linear.B * u_size, axis=1), dtype=float)
    return undriven_noise(linear.A, linear.C, np.hstack([linear.G_d, noise]), size, by_input, 1.0)


def linearised(equations: Equations, parameters: Vector, x_hat: Vector, order: int) -> LinearPart:
    """Return the plant linearised where it works; for r = 0 its linear part where that cannot be evaluated.

    Raises DesignError outside the paper's form for r = 0, and where the plant cannot be linearised.
    """
    if equations.matrices is not None and order == 0:
        found = tangent(equations, parameters, x_hat)
        return equations.linear_part(parameters) if found is None else found
    if order == 0:
        raise DesignError.report(
            "disturbance_order",
            expected="1, 2 or 3",
            received="0",
            likely=f"r = 0 is the paper's design, whose form {equations.name} does not have",
        )
    return require_tangent(equations, parameters, x_hat)


def _output(equations: Equations, parameters: Vector, x_hat: Vector, C: Array) -> Array:
    """Return the size (p,) of the outputs at x̂₀."""
    if equations.matrices is not None:
        return np.asarray(C @ np.array(x_hat, dtype=float))
    u = middle_input(equations.inputs, equations.ranges)
    try:
        return np.array(equations.output(x_hat, u, parameters), dtype=float)
    except (ArithmeticError, ValueError):
        return np.zeros(len(C))
