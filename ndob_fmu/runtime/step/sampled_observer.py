"""Method 2, the default: a Kalman-type observer discretised for the step size that the host requests.

    correct   e = y − C ξ̂⁻,   ξ̂ = ξ̂⁻ + K e                        `measurement_update`, behind the `gate`
    predict   ξ̂ and its covariance from t to t + H                 `time_update`

K comes from the covariance recursion, which begins at `design.start_up`, and is frozen once it has converged. From then
on a sample inside the gate takes a step of generated scalar code (`converged_step`); `step_by_definition` is what that
must do.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import mul

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError, IntegrationError
from ndob_fmu.runtime.design.augmented import Augmented, augment
from ndob_fmu.runtime.design.longest_step import longest_step
from ndob_fmu.runtime.design.minimum_phase import require_zeros_left_of
from ndob_fmu.runtime.design.start_up import StartUp, start_up
from ndob_fmu.runtime.design.stationary_design import StationaryDesign
from ndob_fmu.runtime.design.step_designs import StepDesign, StepDesigns
from ndob_fmu.runtime.design.tuning import Knowledge
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector
from ndob_fmu.runtime.generated_steps import Numbers
from ndob_fmu.runtime.memo import LatestResult
from ndob_fmu.runtime.step.converged_step import ConvergedStep, converged_covariance, converged_step
from ndob_fmu.runtime.step.error_bars import disturbance_std, held_disturbance_std, residual_std
from ndob_fmu.runtime.step.gate import MOST_REJECTIONS
from ndob_fmu.runtime.step.measurement_update import Corrected, Sample, correct, leave_out
from ndob_fmu.runtime.step.observer import Estimate, numbers
from ndob_fmu.runtime.step.sampled_observer_state import CovarianceState, SampledObserverState
from ndob_fmu.runtime.step.step_plan import StepPlan, is_similar, plan_step
from ndob_fmu.runtime.step.time_update import predict_covariance, predict_state

ORDERS = tuple(range(HIGHEST_ORDER + 1))


@dataclass(frozen=True)
class SampledObserver:
    """The observer at given parameters. It remembers nothing between steps but in the state.

    designs: the design for each step size
    start: the covariance before the first sample
    """

    equations: Equations
    parameters: Vector
    designs: StepDesigns
    start: StartUp
    _converged_step: LatestResult[ConvergedStep | None] = field(default_factory=LatestResult, repr=False, compare=False)

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

    def init(self, x_hat: Vector) -> SampledObserverState:
        """Return the state before the first sample, from x̂₀ (n,)."""
        q = len(self.known.disturbance_bound)
        return SampledObserverState(
            xi_hat=(*map(float, x_hat), *(0.0,) * (HIGHEST_ORDER * q)),
            d_hat=(0.0,) * q,
            u=(0.0,) * len(self.equations.inputs),
            innovation=(np.inf,) * len(self.system.C),
            covariance=CovarianceState(
                factor=self.start.factor,
                d_std=numbers(self.known.disturbance_bound),
                converged=False,
                tuned_at=0.0,
                waited=0.0,
                rejected=0,
                age=0,
            ),
        )

    def possible(self, state: SampledObserverState, elapsed: float) -> bool:
        """Return whether numbers in the form of a state can be one, `elapsed` s after the start."""
        c = state.covariance
        values = np.array([*state.xi_hat, *state.d_hat, *state.u, *c.d_std, c.tuned_at, c.waited])
        finite = (
            np.all(np.isfinite(values)) and np.all(np.isfinite(c.factor)) and not np.any(np.isnan(state.innovation))
        )
        return (
            bool(finite)
            and not any(state.xi_hat[len(self.system.A) :])
            and min(c.d_std, default=0.0) >= 0.0
            and c.tuned_at >= 0.0
            and c.waited >= 0.0
            and 0 <= c.rejected <= MOST_REJECTIONS
            and 0 <= c.age <= self.start.samples
        )

    def estimate(self, state: SampledObserverState, y: Vector) -> Estimate:
        """Return what is known when a sample y (p,) has come but no step has been taken from it."""
        sample = self._against_prediction(self._xi(state), y)
        of_state = np.linalg.norm(self.system.C @ state.covariance.factor, axis=1)
        return Estimate(
            x_hat=state.xi_hat[: self._n],
            d_hat=state.d_hat,
            x_at_sample=state.xi_hat[: self._n],
            d_at_sample=state.d_hat,
            d_std=state.covariance.d_std,
            residual=numbers(sample.innovation),
            residual_std=numbers(np.hypot(of_state, np.diag(self.known.R_factor))),
            valid=sample.finite,
        )

    def step(
        self, state: SampledObserverState, u: Vector, y: Vector, H: float
    ) -> tuple[SampledObserverState, Estimate]:
        """Advance by H > 0 s from a sample y (p,), with the input u (m,) held over the step."""
        done = self.step_converged(state, (*map(float, u), *map(float, y)), H)
        if done is None:
            return self.step_by_definition(state, u, y, H)
        after, outputs, xi_at_sample = done
        n, q = self._n, len(after.d_hat)
        return after, Estimate(
            x_hat=outputs[:n],
            d_hat=after.d_hat,
            x_at_sample=xi_at_sample[:n],
            d_at_sample=outputs[n + q : n + 2 * q],
            d_std=after.covariance.d_std,
            residual=after.innovation,
            residual_std=outputs[-1 - len(after.innovation) : -1],
            valid=True,
        )

    def step_converged(
        self, state: SampledObserverState, inputs: Vector, H: float
    ) -> tuple[SampledObserverState, tuple[float, ...], Numbers] | None:
        """Return what `step` does with a converged gain and a sample inside the gate, None for all else.

        inputs: u and y. The result is the state, the numbers of `Estimate` in their order but for x_at_sample, with
        `valid`, and ξ̂ at the sample (n + 3 q2,).
        """
        # Whether this way is taken depends on the arguments alone, so that a state that is restored goes on as it did.
        covariance = state.covariance
        common = self._converged_step.value
        if common is None or common.covariance is not covariance or common.H != H:
            if not covariance.converged:
                return None
            tuned_at = covariance.tuned_at
            common = self._converged_step((H, tuned_at), lambda: self._prepared(H, tuned_at))
            if common is None:
                return None
        try:
            done = common.observer_step(state.xi_hat, inputs, common.constants, common.gain, H)
        except (ArithmeticError, ValueError):
            return None
        if done is None:
            return None
        d_hat, innovation, outputs = done.d_hat, done.innovation, done.outputs
        if common.M_H is not None:
            n, q = self._n, len(d_hat)
            d_hat = tuple(sum(map(mul, row, innovation)) for row in common.M_H)
            outputs = outputs[:n] + d_hat + d_hat + outputs[n + 2 * q :]
        return (
            SampledObserverState(done.xi_hat, d_hat, done.u, innovation, common.covariance),
            outputs,
            done.xi_at_sample,
        )

    def _prepared(self, H: float, tuned_at: float) -> ConvergedStep | None:
        if not is_similar(H, tuned_at):
            return None
        design = self.designs.at(H, tuned_at)
        covariance = converged_covariance(design, tuned_at, self.start)
        return converged_step(self.equations, self.parameters, design, covariance)

    def step_by_definition(
        self, state: SampledObserverState, u: Vector, y: Vector, H: float
    ) -> tuple[SampledObserverState, Estimate]:
        """Do what `step` does for every state and every sample.

        Raises IntegrationError where the step is too long to predict over, DesignError where it has no design.
        """
        if not self._longest_step >= H:
            raise IntegrationError.report(
                "communication step", expected=f"at most {self._longest_step:.3g} s", received=f"{H:g} s"
            )
        before = state.covariance
        plan = plan_step(H, before.tuned_at, before.waited, self.equations.experiment.step_size)
        inputs = tuple(map(float, u))
        state = replace(
            state,
            u=inputs if np.all(np.isfinite(inputs)) else state.u,
            covariance=self._retuned(before, plan.tuned_at),
        )
        design = self.designs.at(plan.designed_for, plan.tuned_at)
        xi_hat = self._xi(state)
        sample = self._against_prediction(xi_hat, y)
        if plan.uses_sample:
            corrected = correct(state, xi_hat, sample, design, self.start, H)
        else:
            corrected = leave_out(state, xi_hat, sample)
        after = self._predict(state, corrected, design, plan, H)
        return after, Estimate(
            x_hat=after.xi_hat[: self._n],
            d_hat=after.d_hat,
            x_at_sample=numbers(corrected.xi_hat[: self._n]),
            d_at_sample=numbers(corrected.d_hat),
            d_std=after.covariance.d_std,
            residual=numbers(sample.innovation),
            residual_std=numbers(residual_std(state.covariance.factor, design)),
            valid=corrected.valid,
        )

    def _predict(
        self, before: SampledObserverState, corrected: Corrected, design: StepDesign, plan: StepPlan, H: float
    ) -> SampledObserverState:
        """Return the state a step H (s) after the sample.

        Raises IntegrationError where it leaves the finite numbers.
        """
        n, d_hat = self._n, corrected.d_hat
        # For r = 0 the corrections K e carry all of d, so that only a step without one needs it here.
        held = np.zeros(len(d_hat)) if corrected.used else d_hat
        xi_hat = predict_state(self.equations, self.parameters, corrected.xi_hat, held, before.u, H)
        if corrected.converged:
            factor = design.stationary.prior_factor
        else:
            starting = corrected.age < self.start.samples
            factor = predict_covariance(corrected.factor, design, H, starting=starting)
        if not (np.all(np.isfinite(xi_hat)) and np.all(np.isfinite(factor)) and np.all(np.isfinite(d_hat))):
            raise IntegrationError("the observer's estimate leaves the finite numbers")
        if self.system.order == 0 and not plan.uses_sample:
            d_std = held_disturbance_std(np.array(before.covariance.d_std), design, H)
        else:
            d_std = disturbance_std(factor, design)
        return SampledObserverState(
            xi_hat=numbers(xi_hat) + (0.0,) * (len(before.xi_hat) - len(xi_hat)),
            d_hat=numbers(xi_hat[n : n + len(d_hat)] if self.system.order else d_hat),
            u=before.u,
            innovation=numbers(corrected.innovation),
            covariance=CovarianceState(
                factor=factor,
                d_std=numbers(d_std),
                converged=corrected.converged,
                tuned_at=plan.tuned_at,
                waited=plan.waited,
                rejected=corrected.rejected,
                age=corrected.next_age,
            ),
        )

    def _retuned(self, covariance: CovarianceState, tuned_at: float) -> CovarianceState:
        """Return the covariance in the scale of intensities tuned at another step, for which no gain is frozen yet."""
        if covariance.tuned_at in (0.0, tuned_at):
            return covariance
        old, new = (self.designs.intensities(H).scale for H in (covariance.tuned_at, tuned_at))
        return replace(covariance, factor=covariance.factor * (new / old), converged=False)

    def _xi(self, state: SampledObserverState) -> Array:
        """Return ξ̂⁻ (N,)."""
        return np.array(state.xi_hat[: len(self.system.A)])

    def _against_prediction(self, xi_hat: Array, y: Vector) -> Sample:
        sample = np.array(y, dtype=float)
        finite = bool(np.all(np.isfinite(sample)))
        return Sample(innovation=sample - self.system.C @ xi_hat if finite else np.zeros(len(sample)), finite=finite)

    @cached_property
    def _longest_step(self) -> float:
        return longest_step(self.equations, self.system.linear)

    @cached_property
    def _n(self) -> int:
        return len(self.equations.states)


def sampled_observer(
    equations: Equations,
    parameters: Vector,
    *,
    order: int,
    noise_std: Vector,
    disturbance_bound: Vector,
    disturbance_rate: Vector,
    x_hat: Vector,
    x_std: Vector,
    alpha: float,
    pi: float,
) -> SampledObserver:
    """Prepare the observer of disturbance order r = 0 … 3; the gain is designed at the first step, which tells H.

    noise_std (p,): ≥ 0, σ of each output's sample; 0 for no noise
    disturbance_bound (q2,): D₀ > 0, the bound of |d|
    disturbance_rate (q2,): ≥ 0, the bound of |d^{(r)}|, of |ḋ| for r = 0; with 0 the pace follows from `pi`
    x_hat (n,): the estimate to start from
    x_std (n,): > 0, the standard deviation of its error
    alpha, pi: α (1/s), which r = 0 needs, and π, which sets the pace where a rate is 0

    Raises DesignError for values outside these ranges, AssumptionError for a zero right of 0, or of −α for r = 0.
    """
    _require("disturbance_order", order in ORDERS, "0, 1, 2 or 3", order)
    _require("alpha", np.isfinite(alpha) and alpha > 0.0, "a finite number > 0", alpha)
    _require("pi_end", np.isfinite(pi) and pi > 0.0, "a finite number > 0", pi)
    sigma, bound, rate, std = (
        np.array(v, dtype=float) for v in (noise_std, disturbance_bound, disturbance_rate, x_std)
    )
    _require("noise_std", bool(np.all(np.isfinite(sigma) & (sigma >= 0.0))), "finite numbers ≥ 0", sigma)
    _require("disturbance_bound", bool(np.all(np.isfinite(bound) & (bound > 0.0))), "finite numbers > 0", bound)
    _require("disturbance_rate", bool(np.all(np.isfinite(rate) & (rate >= 0.0))), "finite numbers ≥ 0", rate)
    _require("hat_start_std", bool(np.all(np.isfinite(std) & (std > 0.0))), "finite numbers > 0", std)
    linear = equations.linear_part(parameters)
    require_zeros_left_of(linear, alpha if order == 0 else 0.0)
    system = augment(linear, order)
    # No sample is better than the rounding of a number of its size.
    size = np.abs(linear.C @ np.array(x_hat, dtype=float)) + np.abs(linear.C) @ std
    known = Knowledge(
        R_factor=np.diag(np.maximum(sigma, 4.0 * np.finfo(float).eps * size)),
        disturbance_bound=bound,
        disturbance_rate=rate,
        lipschitz=equations.lipschitz,
    )
    return SampledObserver(
        equations=equations,
        parameters=parameters,
        designs=StepDesigns(system=system, known=known, x_std=std, alpha=alpha, pi=pi, f_states=equations.f_states),
        start=start_up(system, known, std),
    )


def _require(name: str, condition: bool, expected: str, received: object) -> None:
    if not condition:
        raise DesignError.report(name, expected=expected, received=str(received))
