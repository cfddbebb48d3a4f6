"""The steps of the sampled-data observer as functions of its state: nothing here remembers anything.

What takes long and stays the same for many steps is handed in: the tuning, and the designs as a function whose results
the caller keeps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import isfinite, isinf
from operator import mul

import numpy as np

from ndob_fmu.runtime.base_errors import DesignError, IntegrationError
from ndob_fmu.runtime.design.step_designs import StepDesign
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Vector
from ndob_fmu.runtime.generated_steps import Numbers
from ndob_fmu.runtime.step.converged_step import ConvergedStep, squares_are_usual
from ndob_fmu.runtime.step.filter_state import FilterMemory, SampledObserverState, is_possible
from ndob_fmu.runtime.step.measurement_update import Measured
from ndob_fmu.runtime.step.observer import Estimate, numbers
from ndob_fmu.runtime.step.order_zero import step_of_order_zero
from ndob_fmu.runtime.step.prediction import predicted_before_a_step
from ndob_fmu.runtime.step.preparation import PreparedObserver
from ndob_fmu.runtime.step.start_memory import start_memory
from ndob_fmu.runtime.step.tracking_step import consistency, step_with_covariance
from ndob_fmu.runtime.step.tuned import Tuned, filter_model, frozen

# The first step tells which step to tune for, if it is not below this part of the default experiment's. A step that is
# longer than the tuned one by more than the second factor asks for a new tuning.
_SHORTEST, _LONGEST = 0.1, 3.0

DesignAt = Callable[[float, float, Numbers], StepDesign]


def start_state(observer: PreparedObserver, x_hat: Vector) -> SampledObserverState:
    """Return the state before the first sample, from x̂₀ (n,).

    Raises DesignError where a bound of the disturbance's derivatives is not finite.
    """
    layout, settings, p = observer.layout, observer.settings, len(observer.equations.outputs)
    nominal = tuple(settings.disturbance_nominal)
    xi = np.zeros(layout.size)
    xi[: layout.n] = x_hat
    xi[layout.disturbance] = nominal if layout.order else ()
    xi[layout.parameters] = [observer.parameters[i] for i in layout.uncertain]
    state = SampledObserverState(
        xi_hat=layout.packed(xi),
        d_hat=nominal,
        d_std=numbers(observer.known.disturbance_bound),
        u=(0.0,) * len(observer.equations.inputs),
        innovation=(0.0,) * p,
        sample=(np.nan,) * p,
        squares=(1.0,) * p,
        memory=start_memory(filter_model(observer, 1.0, 0.0)),
    )
    if not is_possible_state(observer, state):
        raise DesignError.report(
            "disturbance_bound and disturbance_rate",
            expected="bounds of the disturbance and its derivatives that are finite",
            received=f"{min(settings.disturbance_bound):g} and {max(settings.disturbance_rate):g}",
        )
    return state


def is_possible_state(observer: PreparedObserver, state: SampledObserverState) -> bool:
    """Return whether numbers in the form of a state can be one."""
    memory, layout = state.memory, observer.layout
    values = (*state.xi_hat, *state.d_hat, *state.d_std, *state.u, *state.innovation, *state.squares)
    beyond = state.xi_hat[layout.series.stop : layout.n + HIGHEST_ORDER * layout.q]
    return bool(
        all(map(isfinite, values))
        and not any(beyond)
        and min(state.d_std) >= 0.0
        and min(state.squares) >= 0.0
        and not any(map(isinf, state.sample))
        and is_possible(memory)
    )


def estimate_before_a_step(observer: PreparedObserver, state: SampledObserverState, y: Vector) -> Estimate:
    """Return what is known when a sample y (p,) has come but no step has been taken from it."""
    innovation, std = (0.0,) * len(y), numbers(observer.noise_std)
    try:
        prediction = predicted_before_a_step(filter_model(observer, 1.0, 0.0), state, y)
        innovation, std = tuple(prediction.innovation), tuple(prediction.std)
    except (ArithmeticError, ValueError):  # the first step says that the equations cannot be evaluated
        pass
    x_hat = state.xi_hat[: observer.layout.n]
    return Estimate(
        x_hat=x_hat,
        d_hat=state.d_hat,
        x_at_sample=x_hat,
        d_at_sample=state.d_hat,
        d_std=state.d_std,
        d_lagged=state.d_hat,
        d_lagged_std=state.d_std,
        residual=innovation,
        residual_std=std,
        valid=bool(np.any(np.isfinite(y))),
        consistency=consistency(state.squares),
    )


def step_to_tune_for(observer: PreparedObserver, memory: FilterMemory, H: float) -> float:
    """Return the step (s) that the intensities are tuned for, in a step H (s).

    Raises IntegrationError where that is too long to predict over.
    """
    if not observer.longest >= H:
        raise IntegrationError.report(
            "communication step", expected=f"at most {observer.longest:.3g} s", received=f"{H:g} s"
        )
    tuned_at = memory.tuned_at
    if tuned_at == 0.0 or _LONGEST * tuned_at < H:
        default = observer.equations.experiment.step_size
        return H if _SHORTEST * default <= H else max(default, tuned_at)
    return tuned_at


def step_by_definition(
    observer: PreparedObserver,
    tuned: Tuned,
    design_at: DesignAt,
    state: SampledObserverState,
    u: Numbers,
    y: Numbers,
    H: float,
) -> tuple[SampledObserverState, Estimate]:
    """Do what a step does for every state and every sample, with the covariance.

    tuned: for the step that `step_to_tune_for` returns
    design_at: design_at(H, tuned_at, noise) returns the design for a step H (s), as `StepDesigns.at`

    Raises IntegrationError where the equations cannot be evaluated or numbers leave the finite ones, DesignError where
    the step has no design.
    """
    memory = replace(state.memory, tuned_at=tuned.H)
    held = u if np.all(np.isfinite(u)) else state.u
    # A sample belongs to the input until then, which outputs with feed-through show. The first one has only this.
    state = replace(state, u=held if memory.age == 0 else state.u, memory=memory)
    try:
        after, estimate, measured = _stepped(tuned, design_at, state, held, y, H)
    except (ArithmeticError, ValueError) as error:
        raise IntegrationError(f"model: its equations cannot be evaluated at the estimate ({error})") from error
    after = frozen(tuned, design_at, after, measured, H, memory.step)
    if not is_possible_state(observer, after):
        raise IntegrationError("what the observer remembers leaves the finite numbers")
    return after, estimate


def _stepped(
    tuned: Tuned, design_at: DesignAt, state: SampledObserverState, u: Numbers, sample: Numbers, H: float
) -> tuple[SampledObserverState, Estimate, Measured]:
    model = tuned.model
    if model.layout.order:
        noise = model.noise_ratios(state.memory.sensors)
        return step_with_covariance(model, state, u, sample, H, tuned.intensity(H, noise))
    told = (1.0,) * len(sample)
    return step_of_order_zero(model, replace(state, u=u), sample, H, design_at(tuned.H, tuned.H, told))


def step_converged(
    common: ConvergedStep, n: int, state: SampledObserverState, inputs: Vector, H: float
) -> tuple[SampledObserverState, Numbers, Numbers] | None:
    """Return what a step does with a frozen gain and a sample that is not suspicious, None for all else.

    n: of states; inputs: u and y

    The result is the state, the numbers of `Estimate` in their order but for x_at_sample, with `valid`, and ξ̂ at the
    sample (n + 3 q2,).
    """
    try:
        done = common.observer_step(state.xi_hat, inputs, state.squares, common.constants, common.gain, H)
    except (ArithmeticError, ValueError):
        return None
    if done is None or not squares_are_usual(done.squares, common.least_squares):
        return None
    d_hat, outputs = done.d_hat, done.outputs
    if common.M_H is not None:
        d_hat = tuple(sum(map(mul, row, done.innovation)) for row in common.M_H)
        std, behind = common.gain.d_std, n + 5 * len(common.M_H)
        outputs = (*outputs[:n], *d_hat, *d_hat, *std, *d_hat, *std, *outputs[behind:])
    after = SampledObserverState(
        done.xi_hat,
        d_hat,
        common.gain.d_std,
        done.u,
        done.innovation,
        done.sample,
        done.squares,
        state.memory,
    )
    return after, outputs, done.xi_at_sample
