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

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError, IntegrationError
from ndob_fmu.runtime.design.augmented import Augmented, augment
from ndob_fmu.runtime.design.intensity_law import IntensityLaw
from ndob_fmu.runtime.design.longest_step import longest_step
from ndob_fmu.runtime.design.minimum_phase import require_zeros_left_of
from ndob_fmu.runtime.design.operating_point import middle_input, tangent
from ndob_fmu.runtime.design.start_up import start_up
from ndob_fmu.runtime.design.stationary_design import Intensities, StationaryDesign
from ndob_fmu.runtime.design.step_designs import StepDesigns
from ndob_fmu.runtime.design.tuning import Knowledge, bandwidth_of, squared_errors
from ndob_fmu.runtime.design.undriven_noise import undriven_noise
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector
from ndob_fmu.runtime.generated_steps import Numbers
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.memo import LatestResult
from ndob_fmu.runtime.step.adaptive_noise import LEAST_RATIO, for_a_frozen_gain, is_sure
from ndob_fmu.runtime.step.converged_step import (
    ConvergedStep,
    converged_step,
    frozen_memory,
    has_converged,
    is_quiet,
    least_squares,
    squares_are_usual,
)
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import SampledObserverState, is_possible
from ndob_fmu.runtime.step.layout import Layout
from ndob_fmu.runtime.step.measurement_update import Measured
from ndob_fmu.runtime.step.observer import Estimate, numbers
from ndob_fmu.runtime.step.order_zero import step_of_order_zero
from ndob_fmu.runtime.step.prediction import predicted_before_a_step
from ndob_fmu.runtime.step.settings import ObserverSettings, check_settings
from ndob_fmu.runtime.step.start_memory import start_memory
from ndob_fmu.runtime.step.tracking_step import consistency, step_with_covariance

# A frozen gain that takes f for noise is as good as one that follows f's slopes up to this ratio of predicted errors.
_AS_GOOD = 1.1
# The first step tells which step to tune for, if it is not below this part of the default experiment's. A step that is
# longer than the tuned one by more than the second factor asks for a new tuning.
_SHORTEST, _LONGEST = 0.1, 3.0


@dataclass(frozen=True)
class Tuned:
    """The observer tuned for steps about H (s).

    model: its constants
    intensities: of the noise at H
    law: of the intensities for other steps and noises
    freezes: whether a frozen gain is as good as the running covariance
    """

    H: float
    model: FilterModel
    intensities: Intensities
    law: IntensityLaw | None
    freezes: bool

    def intensity(self, H: float, noise: float) -> Array:
        """Return the intensity (q2,) behind the r-th derivative of d at a step H (s), for σ² larger by a factor."""
        at_tuned = self.intensities.disturbance * self.intensities.scale**2
        if self.law is None or (noise == 1.0 and self.H == H):
            return np.asarray(at_tuned)
        return np.asarray(at_tuned * self.law.at(H, float(np.sqrt(noise))) / self.law.at(self.H))


@dataclass(frozen=True)
class SampledObserver:
    """The observer at given parameters. It remembers nothing between steps but in the state.

    layout: of ξ
    noise_std (p,): of the samples, at least their rounding
    rounding (p,): that rounding
    undriven (n,): intensity of the noise on states that nothing else drives, over the step
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
    designs: StepDesigns
    tracking: StepDesigns
    longest: float
    _tuned: LatestResult[Tuned] = field(default_factory=LatestResult, repr=False, compare=False)
    _converged: LatestResult[ConvergedStep | None] = field(default_factory=LatestResult, repr=False, compare=False)

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
            memory=start_memory(self._model(1.0, 0.0)),
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
            prediction = predicted_before_a_step(self._model(1.0, 0.0), state, y)
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
        return self._frozen(tuned, after, measured, H), estimate

    def _stepped(
        self, tuned: Tuned, state: SampledObserverState, u: Numbers, sample: Vector, H: float
    ) -> tuple[SampledObserverState, Estimate, Measured]:
        memory = state.memory
        if self.layout.order:
            noise = float(np.exp(np.mean(np.log(tuned.model.noise_ratios(memory.sensors)))))
            return step_with_covariance(tuned.model, state, u, sample, H, tuned.intensity(H, noise))
        return step_of_order_zero(tuned.model, replace(state, u=u), sample, H, self.designs.at(tuned.H, tuned.H))

    def tuned(self, H: float) -> Tuned:
        """Return what is tuned for steps about H (s). Raises DesignError where there is no tuning."""
        return self._tuned((H,), lambda: self._tune(H))

    def _tune(self, H: float) -> Tuned:
        layout = self.layout
        if layout.order == 0:
            intensities = self.designs.intensities(H)
            return Tuned(H, self._model(intensities.scale, 0.0), intensities, None, freezes=self._may_freeze)
        designs, frozen_error = self.designs, np.inf
        try:
            frozen_error = sum(squared_errors(self.designs.at(H).stationary, self.known))
        except DesignError:
            designs = self.tracking
        error = np.inf
        try:
            error = sum(squared_errors(self.tracking.at(H).stationary, self.known))
            intensities = self.tracking.intensities(H)
            designs = self.tracking
        except DesignError:
            intensities = designs.intensities(H)
        freezes = frozen_error <= _AS_GOOD**2 * error and frozen_error < np.inf
        if freezes:
            intensities = self.designs.intensities(H)
        bandwidth = bandwidth_of(self.tracking.system, H, float(intensities.disturbance[0]), self.known)
        return Tuned(
            H,
            self._model(intensities.scale, 0.25 / bandwidth),
            intensities,
            designs.law(H),
            freezes=freezes and self._may_freeze,
        )

    @property
    def _may_freeze(self) -> bool:
        settings, layout = self.settings, self.layout
        plain = not (
            layout.biased
            or layout.uncertain
            or any(settings.sensors.delay)
            or any(settings.state_noise)
            or any(self.undriven)
        )
        # Outside the paper's form no constant matrices hold wherever the plant is.
        return plain and settings.lag == 0.0 and self.equations.matrices is not None

    def _frozen(self, tuned: Tuned, after: SampledObserverState, measured: Measured, H: float) -> SampledObserverState:
        """Return the state with a frozen gain, where that is as good from now on."""
        memory, model = after.memory, tuned.model
        started = memory.age >= model.start_samples and memory.steady >= model.start_samples
        if not (tuned.freezes and started) or memory.lost:
            return after
        noise = for_a_frozen_gain(model.noise_ratios(memory.sensors), model.least_noise.tolist())
        settled = all(ratio == 1.0 or is_sure(s.counted) for ratio, s in zip(noise, memory.sensors, strict=True))
        if not settled or not is_quiet(measured, least_squares(model, noise)):
            return after
        try:
            design = self.designs.at(H, memory.tuned_at, noise)
        except DesignError:
            return after
        if not has_converged(model, memory, design):
            return after
        return replace(after, memory=frozen_memory(model, memory, design, noise))

    def _prepared(self, H: float, tuned_at: float, noise: tuple[float, ...]) -> ConvergedStep | None:
        return converged_step(self.tuned(tuned_at).model, self.designs.at(H, tuned_at, noise), tuned_at, noise)

    def _model(self, scale: float, jump_spacing: float) -> FilterModel:
        settings = self.settings
        start = start_up(self.system, self.known, np.array(settings.x_std, dtype=float))
        return FilterModel(
            equations=self.equations,
            parameters=self.parameters,
            settings=settings,
            layout=self.layout,
            noise_variance=(self.noise_std * scale) ** 2,
            scale=scale,
            start_std=np.concatenate(
                [
                    np.diag(start.factor),
                    [settings.sensors.bias_std[i] for i in self.layout.biased],
                    [settings.parameter_std[i] for i in self.layout.uncertain],
                ]
            ),
            undriven=self.undriven,
            least_noise=np.ones(len(self.noise_std))
            if scale > 1.0
            else np.maximum((self.rounding / self.noise_std) ** 2, LEAST_RATIO),
            jump_spacing=jump_spacing,
        )


def sampled_observer(
    equations: Equations, parameters: Vector, settings: ObserverSettings, x_hat: Vector
) -> SampledObserver:
    """Prepare the observer for an estimate x̂₀ (n,) to start from; it is tuned at the first step, which tells H.

    Raises DesignError for settings outside their ranges, AssumptionError for a zero right of 0, or of −α for r = 0.
    """
    check_settings(settings)
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
    known = Knowledge(
        R_factor=np.diag(noise), disturbance_bound=bound, disturbance_rate=rate, lipschitz=equations.lipschitz
    )
    return SampledObserver(
        equations=equations,
        parameters=parameters,
        settings=settings,
        layout=Layout(
            n=len(linear.A),
            q=linear.G_d.shape[1],
            order=order,
            biased=tuple(i for i, s in enumerate(settings.sensors.bias_std) if s > 0.0),
            uncertain=tuple(i for i, s in enumerate(settings.parameter_std) if s > 0.0),
        ),
        noise_std=noise,
        rounding=rounding,
        undriven=_undriven(working, settings, x_hat),
        designs=StepDesigns(
            system=augment(linear, order),
            known=known,
            x_std=std,
            alpha=settings.alpha,
            pi=settings.pi,
        ),
        tracking=StepDesigns(
            system=augment(working, order),
            known=replace(known, lipschitz=0.0),
            x_std=std,
            alpha=settings.alpha,
            pi=settings.pi,
        ),
        longest=longest_step(equations, linear),
    )


def _undriven(linear: LinearPart, settings: ObserverSettings, x_hat: Vector) -> Array:
    """Return the intensities (n,) of `undriven_noise`, over the step, with states of the size of x̂₀ and its error."""
    if settings.order == 0:
        return np.zeros(len(linear.A))
    noise = np.diag(np.array(settings.state_noise, dtype=float))
    size = np.abs(np.array(x_hat, dtype=float)) + np.array(settings.x_std, dtype=float)
    return undriven_noise(linear.A, linear.C, np.hstack([linear.G_d, noise]), size, 1.0)


def linearised(equations: Equations, parameters: Vector, x_hat: Vector, order: int) -> LinearPart:
    """Return the plant linearised where it works; its linear part where that cannot be evaluated.

    Raises DesignError outside the paper's form for r = 0, and where the plant cannot be linearised.
    """
    found = tangent(equations, parameters, x_hat)
    if equations.matrices is not None:
        return equations.linear_part(parameters) if found is None else found
    if order == 0:
        raise DesignError.report(
            "disturbance_order",
            expected="1, 2 or 3",
            received="0",
            likely=f"r = 0 is the paper's design, whose form {equations.name} does not have",
        )
    if found is None:
        raise DesignError.report(
            f"{equations.name} at the estimate to start from",
            expected="finite slopes of the derivatives and outputs",
            received="slopes that cannot be evaluated",
            likely="a root or a quotient of 0; start elsewhere, or tell the ranges where the plant works",
        )
    return found


def _output(equations: Equations, parameters: Vector, x_hat: Vector, C: Array) -> Array:
    """Return the size (p,) of the outputs at x̂₀."""
    if equations.matrices is not None:
        return np.asarray(C @ np.array(x_hat, dtype=float))
    u = middle_input(equations.inputs, equations.ranges)
    try:
        return np.array(equations.output(x_hat, u, parameters), dtype=float)
    except (ArithmeticError, ValueError):
        return np.zeros(len(C))
