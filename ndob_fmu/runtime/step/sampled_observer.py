"""Method 2, the default: an extended Kalman filter, discretised for each step that the host requests.

    correct   ξ̂ = ξ̂⁻ + K (y − ŷ), one output at a time       `measurement_update`, `faulty_samples`, `jump_bank`
    predict   ξ̂ and its covariance from t to t + H           `time_update`

The covariance begins at what is known of ξ̂₀ and of the disturbance, and runs along (`tracking_step`). Where a frozen
gain is as good and nothing is unusual, steps of generated scalar code take its place (`converged_step`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np

from ndob_fmu.runtime.design.intensity_law import IntensityLaw
from ndob_fmu.runtime.design.stationary_design import Intensities
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.generated_steps import Numbers
from ndob_fmu.runtime.memo import LatestResult
from ndob_fmu.runtime.step.converged_step import ConvergedStep, converged_step, is_near
from ndob_fmu.runtime.step.filter_state import SampledObserverState
from ndob_fmu.runtime.step.observer import Estimate
from ndob_fmu.runtime.step.preparation import PreparedObserver, prepared
from ndob_fmu.runtime.step.sampled_step import (
    estimate_before_a_step,
    is_possible_state,
    start_state,
    step_by_definition,
    step_converged,
    step_to_tune_for,
)
from ndob_fmu.runtime.step.settings import ObserverSettings, check_settings
from ndob_fmu.runtime.step.tuned import Tuned, tune, tuned_to


@dataclass(frozen=True)
class SampledObserver(PreparedObserver):
    """The observer at given parameters. It remembers nothing between steps but in the state."""

    _tuned: LatestResult[Tuned] = field(default_factory=LatestResult, repr=False, compare=False)
    _converged: LatestResult[ConvergedStep | None] = field(default_factory=LatestResult, repr=False, compare=False)

    def init(self, x_hat: Vector) -> SampledObserverState:
        """Return the state before the first sample, from x̂₀ (n,)."""
        return start_state(self, x_hat)

    def possible(self, state: SampledObserverState) -> bool:
        """Return whether numbers in the form of a state can be one."""
        return is_possible_state(self, state)

    def estimate(self, state: SampledObserverState, y: Vector) -> Estimate:
        """Return what is known when a sample y (p,) has come but no step has been taken from it."""
        return estimate_before_a_step(self, state, y)

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
        if not memory.converged or not is_near(memory.step, H):
            return None
        common = self._converged.value
        step, noise, tuned_at = memory.step, memory.frozen_noise, memory.tuned_at
        if common is None or step != common.H or common.tuned_at != tuned_at or common.noise != noise:
            common = self._converged((step, tuned_at, *noise), lambda: self._prepared(step, tuned_at, noise))
            if common is None:
                return None
        return step_converged(common, self.layout.n, state, inputs, H)

    def step_by_definition(
        self, state: SampledObserverState, u: Vector, y: Vector, H: float
    ) -> tuple[SampledObserverState, Estimate]:
        """Do what `step` does for every state and every sample, with the covariance.

        Raises IntegrationError where the step is too long to predict over, DesignError where it has no design.
        """
        tuned = self.tuned(step_to_tune_for(self, state.memory, H))
        return step_by_definition(self, tuned, self.designs.at, state, tuple(map(float, u)), tuple(map(float, y)), H)

    def tuned(self, H: float) -> Tuned:
        """Return what is tuned for steps about H (s). Raises DesignError where there is no tuning."""
        return self._tuned((H,), lambda: tune(self, H))

    def take_tuning(self, H: float, intensities: Intensities, law: IntensityLaw, *, freezes: bool) -> None:
        """Take the tuning for steps about H (s) from an observer with the same parameters: it takes time to find."""
        self._tuned((H,), lambda: tuned_to(self, H, intensities, law, freezes=freezes))

    def _prepared(self, H: float, tuned_at: float, noise: tuple[float, ...]) -> ConvergedStep | None:
        return converged_step(self.tuned(tuned_at).model, self.designs.at(H, tuned_at, noise), tuned_at, noise)


def sampled_observer(
    equations: Equations, parameters: Vector, settings: ObserverSettings, x_hat: Vector
) -> SampledObserver:
    """Prepare the observer for an estimate x̂₀ (n,) to start from; it is tuned at the first step, which tells H.

    Raises DesignError for settings outside their ranges, AssumptionError for a zero right of 0, or of −α for r = 0.
    """
    check_settings(settings)
    found = prepared(equations, parameters, settings, x_hat)
    return SampledObserver(**{one.name: getattr(found, one.name) for one in fields(found)})


def without_adaptation(observer: SampledObserver) -> SampledObserver:
    """Return the same observer, whose noise stays as told."""
    settings = replace(observer.settings, adapt_noise=False)
    return replace(observer, settings=settings, _tuned=LatestResult(), _converged=LatestResult())
