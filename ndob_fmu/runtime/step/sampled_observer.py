"""The everyday observer: a sampled-data design at whatever step the host takes, known only when it takes it.

    update    e = y − C ξ̂⁻,   ξ̂ = ξ̂⁻ + K e                       d̂(t) = δ̂₁       (r = 0: M_H S_∞ S⁻¹ e)
    predict   x̂' = A x̂ + B u + G_f f(x̂, u) + G_d d̂(t),   d̂⁽ʳ⁾ = 0,   from t to t + H

K comes from the covariance recursion, started from an honest prior, and is frozen once it has come to rest. From then
on a usual sample takes a step of generated scalar code (`Equations.steps`); `step_by_definition` is what that must do.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import factorial
from operator import mul

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError, IntegrationError
from ndob_fmu.runtime.design.augmented import Augmented, augment, discretise
from ndob_fmu.runtime.design.minimum_phase import require_zeros_left_of
from ndob_fmu.runtime.design.sampled_design import Intensities, SampledDesign, sampled_design, scaled_noise
from ndob_fmu.runtime.design.tuning import Knowledge, from_pi, steady_residual_std, steady_std, tuned_intensities
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector
from ndob_fmu.runtime.memo import Latest, Shared, by_value
from ndob_fmu.runtime.numerics.integrate import MOST_SUBSTEPS, integrate
from ndob_fmu.runtime.numerics.kalman import Update, gain_change, predict, update
from ndob_fmu.runtime.step.observer import Estimate, numbers
from ndob_fmu.runtime.step.sampled_state import Confidence, Numbers, SampledState, StepAtRest
from ndob_fmu.runtime.step.sampling import Sampling, is_similar, sampling

ORDERS = tuple(range(HIGHEST_ORDER + 1))
_AT_REST = 1e-7
# A thousand instances of the same parameters need one design.
_TUNED: Shared[Intensities] = Shared(64)
_DESIGNS: Shared[SampledDesign] = Shared(16)
_LARGEST_GROWTH = 700.0  # e^700 is nearly the largest number
_FAR = 1000.0
# A sample is refused where it lies further from its prediction than this many standard deviations, twice what the class
# of disturbances always does, and what a jump of d by 2 D₀ could have led to since the sample before, together. After
# so many refusals in a row it is the estimate that must be wrong: it starts anew.
_GATE = 6.0
_MOST_REFUSALS = 10
# The covariance of states whose sums are measured keeps no digit of a noise that is smaller than this part of theirs.
_LEAST_NOISE = 1e-10
# Steps per state after a start before which the gain is not frozen.
_START_UP = 3


@dataclass(frozen=True)
class SampledObserver:
    """init(x̂₀) → state; step(state, u, y, H) → (state, estimate).

    x_std (n,): standard deviations of x̂₀'s error. Where `known` has no rate of the disturbance (0), `pi` sets the pace.
    """

    equations: Equations
    parameters: Vector
    system: Augmented
    known: Knowledge
    x_std: Array
    alpha: float
    pi: float
    _tuned: Latest[Intensities] = field(default_factory=Latest, repr=False, compare=False)
    _designed: Latest[SampledDesign] = field(default_factory=Latest, repr=False, compare=False)
    _rest: Latest[StepAtRest | None] = field(default_factory=Latest, repr=False, compare=False)
    _fades: Latest[bool] = field(default_factory=Latest, repr=False, compare=False)
    _steady_std: Latest[Array] = field(default_factory=Latest, repr=False, compare=False)
    _steady_residual_std: Latest[Array] = field(default_factory=Latest, repr=False, compare=False)

    def init(self, x_hat: Vector) -> SampledState:
        """Return the state before the first sample, from x̂₀ (n,)."""
        q = len(self.known.disturbance_bound)
        return SampledState(
            xi_hat=(*map(float, x_hat), *(0.0,) * (HIGHEST_ORDER * q)),
            d_hat=(0.0,) * q,
            u=(0.0,) * self.system.linear.B.shape[1],
            deviation=(np.inf,) * len(self.system.C),
            confidence=Confidence(
                factor=self._prior_factor(),
                d_std=numbers(self.known.disturbance_bound),
                at_rest=False,
                tuned_at=0.0,
                waited=0.0,
                refused=0,
                age=0,
            ),
        )

    def possible(self, state: SampledState, elapsed: float) -> bool:
        """Return whether numbers in the form of a state can be one, whenever that is."""
        c = state.confidence
        values = np.array([*state.xi_hat, *state.d_hat, *state.u, *c.d_std, c.tuned_at, c.waited])
        return (
            bool(
                np.all(np.isfinite(values)) and np.all(np.isfinite(c.factor)) and not np.any(np.isnan(state.deviation))
            )
            and not any(state.xi_hat[len(self.system.A) :])
            and min(c.d_std, default=0.0) >= 0.0
            and c.tuned_at >= 0.0
            and c.waited >= 0.0
            and 0 <= c.refused <= _MOST_REFUSALS
            and 0 <= c.age <= self._start_up
        )

    def design(self, H: float, tuned_at: float | None = None) -> SampledDesign:
        """Return the stationary design at a step H (s), with the intensities tuned for a step near it.

        Raises DesignError where there is none.
        """
        at = tuned_at or H
        intensities = self._tuned_intensities(at)

        def compute() -> SampledDesign:
            return sampled_design(self.system, H, self.known.R_factor, intensities, self.alpha)

        return self._designed((H, at), lambda: _DESIGNS((H, at, self._task), compute))

    def estimate(self, state: SampledState, y: Vector) -> Estimate:
        """Return what is known when a sample y (p,) has come but no step has been taken from it."""
        residual, finite = self._residual(self._xi(state), y)
        seen = np.linalg.norm(self.system.C @ state.confidence.factor, axis=1)
        return Estimate(
            x_hat=state.xi_hat[: self._n],
            d_hat=state.d_hat,
            x_at_sample=state.xi_hat[: self._n],
            d_at_sample=state.d_hat,
            d_std=state.confidence.d_std,
            residual=numbers(residual),
            residual_std=numbers(np.hypot(seen, np.diag(self.known.R_factor))),
            valid=finite,
        )

    def step(self, state: SampledState, u: Vector, y: Vector, H: float) -> tuple[SampledState, Estimate]:
        """Advance by H > 0 s from a sample y (p,), with the input u (m,) held over the step."""
        done = self.step_at_rest(state, (*map(float, u), *map(float, y)), H)
        if done is None:
            return self.step_by_definition(state, u, y, H)
        after, outputs, xi_at_sample = done
        n, q = self._n, len(after.d_hat)
        return after, Estimate(
            x_hat=outputs[:n],
            d_hat=after.d_hat,
            x_at_sample=xi_at_sample[:n],
            d_at_sample=outputs[n + q : n + 2 * q],
            d_std=after.confidence.d_std,
            residual=after.deviation,
            residual_std=outputs[-1 - len(after.deviation) : -1],
            valid=True,
        )

    def step_at_rest(
        self, state: SampledState, inputs: Vector, H: float
    ) -> tuple[SampledState, tuple[float, ...], Numbers] | None:
        """Return what `step` does with a usual sample once the gain is frozen, None for any other; inputs: u and y.

        That is the state, the numbers of `Estimate` in their order but for x_at_sample, with `valid`, and ξ̂ at the
        sample (n + 3 q2,).
        """
        # Whether this way is taken depends on the arguments alone, so that a state that is restored goes on as it did.
        confidence = state.confidence
        rest = self._rest.value
        if rest is None or rest.confidence is not confidence or rest.H != H:
            tuned_at = confidence.tuned_at
            rest = self._rest((H, tuned_at), lambda: self._at_rest(H, tuned_at)) if confidence.at_rest else None
            if rest is None:
                return None
        try:
            done = rest.observer_step(state.xi_hat, inputs, rest.constants, rest.frozen, H)
        except (ArithmeticError, ValueError):
            return None
        if done is None:
            return None
        xi_hat, outputs, xi_at_sample, residual, u, d_hat = done
        if rest.M_H is not None:
            n, q = self._n, len(d_hat)
            d_hat = tuple(sum(map(mul, row, residual)) for row in rest.M_H)
            outputs = outputs[:n] + d_hat + d_hat + outputs[n + 2 * q :]
        return SampledState(xi_hat, d_hat, u, residual, rest.confidence), outputs, xi_at_sample

    def _at_rest(self, H: float, tuned_at: float) -> StepAtRest | None:
        if not is_similar(H, tuned_at):
            return None
        try:
            constants = self.equations.steps.observer_constants(self.parameters)
        except (ArithmeticError, ValueError):
            return None
        design = self.design(H, tuned_at)
        missing = HIGHEST_ORDER * len(self.known.disturbance_bound) - len(self.system.A) + self._n
        K = np.vstack([design.rest.K, np.zeros((missing, len(self.system.C)))])
        gate = self._usual_deviation(design.rest.innovation_factor, design)
        d_std = numbers(self._std(design, design.prior_factor))
        residual_std = numbers(self._residual_std(design, design.prior_factor))
        return StepAtRest(
            H=H,
            observer_step=self.equations.steps.observer_step,
            constants=constants,
            frozen=(*gate.tolist(), *d_std, *residual_std, *K.ravel().tolist()),
            M_H=None if design.M_H is None else tuple(map(tuple, design.M_H.tolist())),
            confidence=Confidence(
                factor=design.prior_factor,
                d_std=d_std,
                at_rest=True,
                tuned_at=tuned_at,
                waited=0.0,
                refused=0,
                age=self._start_up,
            ),
        )

    def step_by_definition(self, state: SampledState, u: Vector, y: Vector, H: float) -> tuple[SampledState, Estimate]:
        """Do what `step` does for every state and every sample.

        Raises IntegrationError where the step is too long to predict over, DesignError where it has no design.
        """
        if not self._longest_step >= H:
            raise IntegrationError.report(
                "communication step", expected=f"at most {self._longest_step:.3g} s", received=f"{H:g} s"
            )
        plan = sampling(H, state.confidence.tuned_at, state.confidence.waited, self.equations.experiment.step_size)
        inputs = tuple(map(float, u))
        if not np.all(np.isfinite(inputs)):
            inputs = state.u
        before = self._tuned_for(state.confidence, plan.tuned_at)
        design = self.design(plan.designed_for, plan.tuned_at)
        if not plan.used:
            return self._without_sample(replace(state, u=inputs, confidence=before), y, H, plan, design)
        xi_hat, factor, d_hat = self._xi(state), before.factor, np.array(state.d_hat)
        residual, used = self._residual(xi_hat, y)
        measured = design.rest if before.at_rest else update(factor, self.system.C, design.sample_factor)
        refused, age = 0, before.age
        # Before it first comes to rest the covariance knows nothing of f's error, so that no sample can be implausible.
        judged = before.at_rest or before.refused > 0
        deviation = residual
        if judged and not (
            used and np.all(np.abs(deviation) <= self._usual_deviation(measured.innovation_factor, design))
        ):
            plausible = self._plausible_deviation(np.abs(state.deviation), measured.innovation_factor, design)
            implausible = used and not np.all(np.abs(deviation) <= plausible)
            if implausible:
                used, refused = False, before.refused + 1
            if not used:
                deviation = plausible
            if refused > _MOST_REFUSALS:
                measured = update(self._prior_factor(), self.system.C, design.sample_factor)
                used, refused, age = True, 0, 0

        if used:
            xi_hat, factor = xi_hat + measured.K @ residual, measured.factor
            d_hat = self._disturbance(xi_hat, design, measured, residual)
        at_rest = used and age >= self._start_up and design.discrete.H == H
        at_rest = at_rest and (before.at_rest or gain_change(measured, design.rest) <= _AT_REST)
        factor = design.prior_factor if at_rest else self._covariance_ahead(factor, design, H, age)
        xi_after = self._predicted(xi_hat, d_hat, list(inputs), H, coasting=not used)
        if not (np.all(np.isfinite(xi_after)) and np.all(np.isfinite(factor)) and np.all(np.isfinite(d_hat))):
            raise IntegrationError("the observer's estimate leaves the finite numbers")
        d_after = xi_after[self._n : self._n + len(d_hat)] if self.system.order else d_hat
        after = SampledState(
            xi_hat=numbers(xi_after) + (0.0,) * (len(state.xi_hat) - len(xi_after)),
            d_hat=numbers(d_after),
            u=inputs,
            deviation=numbers(deviation),
            confidence=Confidence(
                factor=factor,
                d_std=numbers(self._std(design, factor)),
                at_rest=at_rest,
                tuned_at=plan.tuned_at,
                waited=0.0,
                refused=refused,
                age=min(age + 1, self._start_up),
            ),
        )
        return after, Estimate(
            x_hat=numbers(xi_after[: self._n]),
            d_hat=after.d_hat,
            x_at_sample=numbers(xi_hat[: self._n]),
            d_at_sample=numbers(d_hat),
            d_std=after.confidence.d_std,
            residual=numbers(residual),
            residual_std=numbers(self._residual_std(design, before.factor)),
            valid=used,
        )

    def _without_sample(
        self, state: SampledState, y: Vector, H: float, plan: Sampling, design: SampledDesign
    ) -> tuple[SampledState, Estimate]:
        """Predict over a short step; its sample y (p,) is shown against the prediction and not used."""
        before, d_hat = state.confidence, np.array(state.d_hat)
        residual, finite = self._residual(self._xi(state), y)
        xi_after = self._predicted(self._xi(state), d_hat, state.u, H, coasting=True)
        factor = self._covariance_ahead(before.factor, design, H, before.age)
        if self.system.selector is None:
            # d̂ is held: what d may do meanwhile counts like the bias of `steady_std`.
            d_std = np.array(before.d_std) + self.known.disturbance_rate * H / np.sqrt(3.0)
        else:
            d_hat = xi_after[self._n : self._n + len(d_hat)]
            d_std = self._std(design, factor)
        after = SampledState(
            xi_hat=numbers(xi_after) + (0.0,) * (len(state.xi_hat) - len(xi_after)),
            d_hat=numbers(d_hat),
            u=state.u,
            deviation=state.deviation,
            confidence=replace(
                before,
                factor=factor,
                d_std=numbers(d_std),
                at_rest=False,
                tuned_at=plan.tuned_at,
                waited=plan.waited,
            ),
        )
        return after, Estimate(
            x_hat=numbers(xi_after[: self._n]),
            d_hat=after.d_hat,
            x_at_sample=state.xi_hat[: self._n],
            d_at_sample=state.d_hat,
            d_std=after.confidence.d_std,
            residual=numbers(residual),
            residual_std=numbers(self._residual_std(design, before.factor)),
            valid=finite and before.refused == 0,
        )

    def _tuned_for(self, confidence: Confidence, tuned_at: float) -> Confidence:
        """Return the confidence as it counts for intensities tuned at another step: no gain is frozen for them yet."""
        if confidence.tuned_at in (0.0, tuned_at):
            return confidence
        old, new = self._tuned_intensities(confidence.tuned_at).scale, self._tuned_intensities(tuned_at).scale
        return replace(confidence, factor=confidence.factor * (new / old), at_rest=False)

    def _tuned_intensities(self, H: float) -> Intensities:
        return self._tuned((H,), lambda: _TUNED((H, self._task), lambda: self._intensities(H)))

    @cached_property
    def _task(self) -> tuple[object, ...]:
        """All that intensities and designs depend on besides the step."""
        task: tuple[object, ...] = by_value((self.system, self.known, self.x_std, self.alpha, self.pi))
        return task

    def _xi(self, state: SampledState) -> Array:
        """Return ξ̂⁻ (N,)."""
        return np.array(state.xi_hat[: len(self.system.A)])

    def _residual(self, xi_hat: Array, y: Vector) -> tuple[Array, bool]:
        """Return y − C ξ̂⁻ (p,) and whether the sample is finite; the residual of one that is not is 0."""
        sample = np.array(y, dtype=float)
        finite = bool(np.all(np.isfinite(sample)))
        return (sample - self.system.C @ xi_hat if finite else np.zeros(len(sample))), finite

    @cached_property
    def _longest_step(self) -> float:
        """The longest step (s) that is worth a try.

        Over a longer one errors could grow beyond the largest number, by the plant's fastest mode and ‖G_f‖ γ, or the
        integrator, which is stable for |λ| h < 4, would need too many substeps. As a declared γ may be far larger than
        the slopes of f where the plant works, growth is judged far beyond the model's own step only.
        """
        modes = np.linalg.eigvals(self.system.linear.A)
        growth = max(0.0, float(np.max(modes.real))) + self.system.linear.f_rate(self.equations.lipschitz)
        grown = max(_LARGEST_GROWTH / growth, _FAR * self.equations.experiment.step_size) if growth else np.inf
        fastest = float(np.max(np.abs(modes)))
        return min(grown, 4.0 * MOST_SUBSTEPS / fastest if fastest else np.inf)

    @property
    def _n(self) -> int:
        return len(self.x_std)

    def _prior_factor(self) -> Array:
        r, bound = self.system.order, self.known.disturbance_bound
        # The derivatives in between are bounded as those of a sine with the amplitude and the rate that are.
        pace = (self.known.disturbance_rate / bound) ** (1.0 / max(r, 1))
        return np.diag(np.concatenate([self.x_std, *(bound * pace**i for i in range(r))]))

    @property
    def _start_up(self) -> int:
        return _START_UP * len(self.system.A)

    def _covariance_ahead(self, factor: Array, design: SampledDesign, H: float, age: int) -> Array:
        """Return the covariance's factor (N,N) a step H later, with what f(x) − f(x̂) may do meanwhile.

        That is at most γ times the error of f's states, as far as it exceeds that at rest, which the intensities cover.
        A state that nothing but the plant's zeros forgets keeps f wrong long after the rest is known. Where γ is so
        large that this bound would feed itself for ever, it counts for the start only.
        """
        discrete, noise_factor = design.discrete, design.noise_factor
        if discrete.H != H:
            discrete = discretise(self.system, H, self.alpha)
            noise_factor = scaled_noise(discrete, design.intensities)
        ahead = predict(factor, discrete.filter_phi, noise_factor)
        if age >= self._start_up and not self._f_error_fades(design):
            return ahead
        f_states = list(self.equations.f_states)
        excess = np.sum(ahead[f_states] ** 2) - np.sum(design.prior_factor[f_states] ** 2)
        f_error = self.equations.lipschitz * float(np.sqrt(max(excess, 0.0)))
        return predict(ahead, np.eye(len(ahead)), f_error * discrete.held_f)

    def _f_error_fades(self, design: SampledDesign) -> bool:
        gamma, f_states = self.equations.lipschitz, self.equations.f_states
        return self._fades(_key(design), lambda: gamma**2 * design.variance_of(f_states) < 1.0)

    def _intensities(self, H: float) -> Intensities:
        if np.all(self.known.disturbance_rate > 0.0):
            found = tuned_intensities(self.system, H, self.alpha, self.known)
        else:
            found = from_pi(self.system, H, self.pi, self.known)
        largest = np.abs(self.system.linear.C) @ self.x_std
        scale = float(np.max(_LEAST_NOISE * largest / np.diag(self.known.R_factor)))
        return replace(found, scale=max(found.scale, scale))

    def _usual_deviation(self, innovation_factor: Array, design: SampledDesign) -> Array:
        """Return what noise and the class of disturbances bring about in samples (p,) without any jump."""
        noise = np.linalg.norm(innovation_factor, axis=1) / design.intensities.scale
        return np.asarray(_GATE * noise + 2.0 * design.usual_innovation @ self._usual_disturbance)

    @property
    def _usual_disturbance(self) -> Array:
        """Bound (q2,) of what `SampledDesign.usual_innovation` is the answer to."""
        return self.known.disturbance_rate if self.system.order else self.known.disturbance_bound

    def _plausible_deviation(self, last: Array, innovation_factor: Array, design: SampledDesign) -> Array:
        """Return the largest deviation (p,) that a jump of d by 2 D₀ at most explains, after the one seen last (p,).

        A jump shows in sample after sample, and more in each until the observer catches up. One j samples ago has been
        no larger than the last sample admits, whose noise may have hidden part of it.
        """
        usual = self._usual_deviation(innovation_factor, design)
        responses, largest = design.jump_responses, 2.0 * self.known.disturbance_bound
        with np.errstate(divide="ignore"):
            admitted = np.min((last + usual)[:, None] / responses[:, :-1], axis=2)
        jumps = np.minimum(admitted, largest)
        now = np.einsum("ijpq,ijq->ijpq", responses[:, 1:], jumps)
        return np.asarray(usual + np.max(now, axis=(0, 1)).sum(axis=1))

    def _disturbance(self, xi_hat: Array, design: SampledDesign, measured: Update, residual: Array) -> Array:
        """Return d̂ (q2,) after an update; for r = 0 the output error counts by how credible it is against rest."""
        if design.M_H is None:
            return xi_hat[self._n : self._n + len(self.known.disturbance_bound)]
        if measured is design.rest:
            return np.asarray(design.M_H @ residual)
        innovation_factor = measured.innovation_factor
        credible = np.linalg.solve(innovation_factor.T, np.linalg.solve(innovation_factor, residual))
        S_rest = design.rest.innovation_factor @ design.rest.innovation_factor.T
        return np.asarray(design.M_H @ S_rest @ credible)

    def _predicted(self, xi_hat: Array, d_hat: Array, u: Vector, H: float, *, coasting: bool) -> Array:
        """Return ξ̂⁻ (N,) after H: the plant with d continued by its Taylor series."""
        n, q, r = self._n, len(d_hat), self.system.order
        # For r = 0 the updates K e carry all of d, so that only a step without one needs it here.
        without_order = d_hat[None] if coasting else np.zeros((1, q))
        series = xi_hat[n:].reshape(r, q) if r else without_order

        def derivatives(t: float, x: Array) -> Array:
            d = sum((row * t**i / factorial(i) for i, row in enumerate(series)), np.zeros(q))
            return np.array(self.equations.derivatives(x.tolist(), u, d.tolist(), self.parameters), dtype=float)

        x_after, _ = integrate(derivatives, xi_hat[:n], 0.0, H, H)
        later = [sum((series[j] * H ** (j - i) / factorial(j - i) for j in range(i, r)), np.zeros(q)) for i in range(r)]
        return np.concatenate([x_after, *later])

    def _residual_std(self, design: SampledDesign, factor: Array) -> Array:
        """Return the standard deviation (p,) of a residual: of rest, and what the covariance lies above its own rest.

        factor (N,N): of the covariance before the sample.
        """
        usual = self._usual_disturbance
        steady = self._steady_residual_std(_key(design), lambda: steady_residual_std(design, usual))
        own, rest = self.system.C @ factor, self.system.C @ design.prior_factor
        excess = np.maximum(np.sum(own * own, axis=1) - np.sum(rest * rest, axis=1), 0.0)
        return np.asarray(np.sqrt(steady**2 + excess))

    def _std(self, design: SampledDesign, factor: Array) -> Array:
        """Return the error bar (q2,) of d̂ a step ahead: of rest, and what the covariance lies above its own rest."""
        rate = self.known.disturbance_rate
        steady = self._steady_std(_key(design), lambda: steady_std(design, rate))
        if self.system.selector is None:
            return np.asarray(np.minimum(steady, self.known.disturbance_bound))
        own, rest = self.system.selector @ factor, self.system.selector @ design.prior_factor
        excess = np.maximum(np.sum(own * own, axis=1) - np.sum(rest * rest, axis=1), 0.0)
        return np.asarray(np.sqrt(steady**2 + excess))


def sampled_observer(
    equations: Equations,
    parameters: Vector,
    *,
    order: int,
    noise_std: float,
    disturbance_bound: Vector,
    disturbance_rate: Vector,
    x_hat: Vector,
    x_std: Vector,
    alpha: float,
    pi: float,
) -> SampledObserver:
    """Prepare the observer of disturbance order r = 0 … 3; the gain is designed at the first step, which tells H.

    noise_std: σ of every output's sample, 0 for no noise; disturbance_bound D₀ > 0 and disturbance_rate ≥ 0, (q2,): of
    |d| and |d^{(r)}| (|ḋ| for r = 0); a rate of 0 leaves the pace to `pi`. x_std > 0, (n,): of the error of x_hat (n,).
    Raises DesignError for values outside these ranges, AssumptionError for a zero right of 0, or of −α for r = 0.
    """
    _require("disturbance_order", order in ORDERS, "0, 1, 2 or 3", order)
    _require("noise_std", np.isfinite(noise_std) and noise_std >= 0.0, "a finite number ≥ 0", noise_std)
    _require("alpha", np.isfinite(alpha) and alpha > 0.0, "a finite number > 0", alpha)
    _require("pi_end", np.isfinite(pi) and pi > 0.0, "a finite number > 0", pi)
    bound, rate, std = (np.array(v, dtype=float) for v in (disturbance_bound, disturbance_rate, x_std))
    _require("disturbance_bound", bool(np.all(np.isfinite(bound) & (bound > 0.0))), "finite numbers > 0", bound)
    _require("disturbance_rate", bool(np.all(np.isfinite(rate) & (rate >= 0.0))), "finite numbers ≥ 0", rate)
    _require("hat_start_std", bool(np.all(np.isfinite(std) & (std > 0.0))), "finite numbers > 0", std)
    linear = equations.linear_part(parameters)
    require_zeros_left_of(linear, alpha if order == 0 else 0.0)
    system = augment(linear, order)
    C = system.linear.C
    # No sample is better than the rounding of a number of its size.
    rounding = 4.0 * np.finfo(float).eps * (np.abs(C @ np.array(x_hat, dtype=float)) + np.abs(C) @ std)
    return SampledObserver(
        equations=equations,
        parameters=parameters,
        system=system,
        known=Knowledge(
            R_factor=np.diag(np.maximum(noise_std, rounding)),
            disturbance_bound=bound,
            disturbance_rate=rate,
            lipschitz=equations.lipschitz,
        ),
        x_std=std,
        alpha=alpha,
        pi=pi,
    )


def _key(design: SampledDesign) -> tuple[float, ...]:
    """Return what tells a design from others of the same observer."""
    return design.discrete.H, design.intensities.scale, design.intensities.f, *design.intensities.disturbance.tolist()


def _require(name: str, condition: bool, expected: str, received: object) -> None:
    if not condition:
        raise DesignError.report(name, expected=expected, received=str(received))
