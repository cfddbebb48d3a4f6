"""Method 2, the default: an extended Kalman filter, discretised for each step that the host requests.

    correct   ξ̂ = ξ̂⁻ + K (y − ŷ), one output at a time       `measurement_update`, `faulty_samples`, `jump_bank`
    predict   ξ̂ and its covariance from t to t + H           `time_update`

The covariance begins at what is known of ξ̂₀ and of the disturbance, and runs along (`tracking_step`). Where a frozen
gain is as good and nothing is unusual, steps of generated scalar code take its place (`converged_step`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from operator import mul

import numpy as np

from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector
from ndob_fmu.runtime.generated_steps import Numbers
from ndob_fmu.runtime.memo import LatestResult
from ndob_fmu.runtime.step.converged_step import (
    ConvergedStep,
    converged_step,
    squares_are_usual,
)
from ndob_fmu.runtime.step.filter_state import SampledObserverState, is_possible
from ndob_fmu.runtime.step.measurement_update import Measured
from ndob_fmu.runtime.step.observer import Estimate, numbers
from ndob_fmu.runtime.step.order_zero import step_of_order_zero
from ndob_fmu.runtime.step.prediction import predicted_before_a_step
from ndob_fmu.runtime.step.preparation import PreparedObserver, prepared
from ndob_fmu.runtime.step.settings import ObserverSettings
from ndob_fmu.runtime.step.start_memory import start_memory
from ndob_fmu.runtime.step.tracking_step import consistency, step_with_covariance
from ndob_fmu.runtime.step.tuned import Tuned, filter_model, frozen, tune

# The first step tells which step to tune for, if it is not below this part of the default experiment's. A step that is
# longer than the tuned one by more than the second factor asks for a new tuning.
_SHORTEST, _LONGEST = 0.1, 3.0


@dataclass(frozen=True)
class SampledObserver(PreparedObserver):
    """The observer at given parameters. It remembers nothing between steps but in the state."""

    _tuned: LatestResult[Tuned] = field(default_factory=LatestResult, repr=False, compare=False)
    _converged: LatestResult[ConvergedStep | None] = field(default_factory=LatestResult, repr=False, compare=False)

    def init(self, x_hat: Vector) -> SampledObserverState:
        """Return the state before the first sample, from x̂₀ (n,)."""
        layout, p = self.layout, len(self.equations.outputs)
        xi = np.zeros(layout.size)
        xi[: layout.n] = x_hat
        xi[layout.disturbance] = self._nominal if layout.order else ()
        xi[layout.parameters] = [self.parameters[i] for i in layout.uncertain]
        return SampledObserverState(
            xi_hat=layout.packed(xi),
            d_hat=self._nominal,
            d_std=numbers(self.known.disturbance_bound),
            u=(0.0,) * len(self.equations.inputs),
            innovation=(0.0,) * p,
            sample=(np.nan,) * p,
            squares=(1.0,) * p,
            memory=start_memory(filter_model(self, 1.0, 0.0)),
        )

    @property
    def _nominal(self) -> tuple[float, ...]:
        return tuple(self.settings.disturbance_nominal)

    def possible(self, state: SampledObserverState, elapsed: float) -> bool:
        """Return whether numbers in the form of a state can be one, `elapsed` s after the start."""
        memory, layout = state.memory, self.layout
        values = (*state.xi_hat, *state.d_hat, *state.d_std, *state.u, *state.innovation, *state.squares)
        beyond = state.xi_hat[layout.series.stop : layout.n + HIGHEST_ORDER * layout.q]
        return bool(
            np.all(np.isfinite(values))
            and not any(beyond)
            and min(state.d_std) >= 0.0
            and min(state.squares) >= 0.0
            and not np.any(np.isinf(state.sample))
            and is_possible(memory)
        )

    def estimate(self, state: SampledObserverState, y: Vector) -> Estimate:
        """Return what is known when a sample y (p,) has come but no step has been taken from it."""
        try:
            prediction = predicted_before_a_step(filter_model(self, 1.0, 0.0), state, y)
            innovation, std = tuple(prediction.innovation), tuple(prediction.std)
        except (ArithmeticError, ValueError):  # the first step says that the equations cannot be evaluated
            innovation, std = (0.0,) * len(y), numbers(self.noise_std)
        x_hat = state.xi_hat[: self.layout.n]
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

    def step(
        self, state: SampledObserverState, u: Vector, y: Vector, H: float
    ) -> tuple[SampledObserverState, Estimate]:
        """Advance by H > 0 s from a sample y (p,), with the input u (m,) held over the step.

        Raises IntegrationError where the step is too long to predict over, DesignError where it has no design.
        """
        done = self.step_converged(state, (*map(float, u), *map(float, y)), H)
        if done is None:
            return self.step_by_definition(state, u, y, H)
        after, outputs, xi_at_sample = done
        n, q, p = self.layout.n, self.layout.q, len(y)
        parts = (n, q, q, q, q, q, p, p)
        ends = np.cumsum(parts).tolist()
        x_hat, d_hat, at_sample, d_std, lagged, lagged_std, residual, residual_std = (
            outputs[end - size : end] for size, end in zip(parts, ends, strict=True)
        )
        return after, Estimate(
            x_hat=x_hat,
            d_hat=d_hat,
            x_at_sample=xi_at_sample[:n],
            d_at_sample=at_sample,
            d_std=d_std,
            d_lagged=lagged,
            d_lagged_std=lagged_std,
            residual=residual,
            residual_std=residual_std,
            valid=True,
            consistency=outputs[-1],
        )

    def step_converged(
        self, state: SampledObserverState, inputs: Vector, H: float
    ) -> tuple[SampledObserverState, tuple[float, ...], Numbers] | None:
        """Return what `step` does with a frozen gain and a sample that is not suspicious, None for all else.

        inputs: u and y. The result is the state, the numbers of `Estimate` in their order but for x_at_sample, with
        `valid`, and ξ̂ at the sample (n + 3 q2,).
        """
        # Whether this way is taken depends on the arguments alone, so that a state that is restored goes on as it did.
        memory = state.memory
        if not memory.converged or memory.step != H:
            return None
        common = self._converged.value
        noise, tuned_at = memory.frozen_noise, memory.tuned_at
        if common is None or common.H != H or common.tuned_at != tuned_at or common.noise != noise:
            common = self._converged((H, tuned_at, *noise), lambda: self._prepared(H, tuned_at, noise))
            if common is None:
                return None
        try:
            done = common.observer_step(state.xi_hat, inputs, state.squares, common.constants, common.gain, H)
        except (ArithmeticError, ValueError):
            return None
        if done is None or not squares_are_usual(done.squares, common.least_squares):
            return None
        d_hat, outputs = done.d_hat, done.outputs
        if common.M_H is not None:
            n, q = self.layout.n, self.layout.q
            d_hat = tuple(sum(map(mul, row, done.innovation)) for row in common.M_H)
            std = common.gain.d_std
            outputs = (*outputs[:n], *d_hat, *d_hat, *std, *d_hat, *std, *outputs[n + 5 * q :])
        return (
            SampledObserverState(
                done.xi_hat,
                d_hat,
                common.gain.d_std,
                done.u,
                done.innovation,
                done.sample,
                done.squares,
                memory,
            ),
            outputs,
            done.xi_at_sample,
        )

    def step_by_definition(
        self, state: SampledObserverState, u: Vector, y: Vector, H: float
    ) -> tuple[SampledObserverState, Estimate]:
        """Do what `step` does for every state and every sample, with the covariance.

        Raises IntegrationError where the step is too long to predict over, DesignError where it has no design.
        """
        if not self.longest >= H:
            raise IntegrationError.report(
                "communication step", expected=f"at most {self.longest:.3g} s", received=f"{H:g} s"
            )
        inputs, sample = tuple(map(float, u)), tuple(map(float, y))
        memory = state.memory
        tuned_at = memory.tuned_at
        if tuned_at == 0.0 or _LONGEST * tuned_at < H:
            default = self.equations.experiment.step_size
            tuned_at = H if _SHORTEST * default <= H else max(default, tuned_at)
            memory = replace(memory, tuned_at=tuned_at)
        held = inputs if np.all(np.isfinite(inputs)) else state.u
        # A sample belongs to the input until then, which outputs with feed-through show. The first one has only this.
        state = replace(state, u=held if memory.age == 0 else state.u, memory=memory)
        tuned = self.tuned(tuned_at)
        try:
            after, estimate, measured = self._stepped(tuned, state, held, sample, H)
        except (ArithmeticError, ValueError) as error:
            raise IntegrationError(f"model: its equations cannot be evaluated at the estimate ({error})") from error
        return frozen(self, tuned, after, measured, H), estimate

    def _stepped(
        self, tuned: Tuned, state: SampledObserverState, u: Numbers, sample: Vector, H: float
    ) -> tuple[SampledObserverState, Estimate, Measured]:
        memory = state.memory
        if self.layout.order:
            noise = tuned.model.noise_ratios(memory.sensors)
            return step_with_covariance(tuned.model, state, u, sample, H, tuned.intensity(H, noise))
        return step_of_order_zero(tuned.model, replace(state, u=u), sample, H, self.designs.at(tuned.H, tuned.H))

    def tuned(self, H: float) -> Tuned:
        """Return what is tuned for steps about H (s). Raises DesignError where there is no tuning."""
        return self._tuned((H,), lambda: tune(self, H))

    def _prepared(self, H: float, tuned_at: float, noise: tuple[float, ...]) -> ConvergedStep | None:
        return converged_step(self.tuned(tuned_at).model, self.designs.at(H, tuned_at, noise), tuned_at, noise)


def sampled_observer(
    equations: Equations, parameters: Vector, settings: ObserverSettings, x_hat: Vector
) -> SampledObserver:
    """Prepare the observer for an estimate x̂₀ (n,) to start from; it is tuned at the first step, which tells H.

    Raises DesignError for settings outside their ranges, AssumptionError for a zero right of 0, or of −α for r = 0.
    """
    return prepared(SampledObserver, equations, parameters, settings, x_hat)


def without_adaptation(observer: SampledObserver) -> SampledObserver:
    """Return the same observer, whose noise stays as told."""
    settings = replace(observer.settings, adapt_noise=False)
    return replace(observer, settings=settings, _tuned=LatestResult(), _converged=LatestResult())
