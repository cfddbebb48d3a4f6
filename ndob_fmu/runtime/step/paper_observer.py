"""The paper's observer, eqs. (5)–(6) and (22)–(23), stepped over sampled measurements.

    x̂' = A x̂ + B u + L(π(t)) (y − C x̂) + G_f f(x̂, u),      ŵ = √π W (y − C x̂),      d̂ = [0 I] ŵ

Over a step y(t) is the polynomial of `hold`, u is held, and π(t) runs along its schedule.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError, IntegrationError
from ndob_fmu.runtime.design.gains import orthogonal_factor
from ndob_fmu.runtime.design.minimum_phase import require_zeros_left_of
from ndob_fmu.runtime.design.schedule import GainTable, PiSchedule, gain_table
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.memo import LatestResult
from ndob_fmu.runtime.numerics.exponential import ExponentialStep, exponential_step
from ndob_fmu.runtime.numerics.hold import History, empty_history
from ndob_fmu.runtime.step.observer import Estimate, numbers
from ndob_fmu.runtime.times import same_time

# The explicit part of the integration stays accurate while f and ln π change this little over one substep.
_MOST_SUBSTEPS = 10_000  # in one communication step
_LARGEST_LIPSCHITZ_STEP = 0.5
_LARGEST_LOG_PI_STEP = 0.1


@dataclass(frozen=True)
class ObserverState:
    """All that the observer remembers: x̂ (n,), s since the start, past samples, the last input and estimate ŵ (q,)."""

    x_hat: Array
    elapsed: float
    history: History
    u: Array
    w_hat: Array


@dataclass(frozen=True)
class PaperObserver:
    """init(x̂₀) → state; step(state, u, y, H) → (state, estimate). Holds no hidden state."""

    equations: Equations
    parameters: Vector
    linear: LinearPart
    schedule: PiSchedule
    table: GainTable = field(repr=False)
    hold_degree: int = 2
    noise_std: float = 0.0
    disturbance_bound: Vector = ()
    # These stay the same once π does. They remember a result, not the past: a step's outcome never depends on them.
    _coefficients: LatestResult[ExponentialStep] = field(default_factory=LatestResult, repr=False, compare=False)
    _estimate_gain: LatestResult[Array] = field(default_factory=LatestResult, repr=False, compare=False)
    _d_std: LatestResult[Array] = field(default_factory=LatestResult, repr=False, compare=False)

    def init(self, x_hat: Vector) -> ObserverState:
        """Return the state that starts from x̂₀ (n,)."""
        return ObserverState(
            x_hat=np.array(x_hat, dtype=float),
            elapsed=0.0,
            history=empty_history(len(self.linear.C)),
            u=np.zeros(self.linear.B.shape[1]),
            w_hat=np.zeros(self.linear.G.shape[1]),
        )

    def possible(self, state: ObserverState, elapsed: float) -> bool:
        """Return whether numbers in the form of a state can be one, `elapsed` s after the start."""
        finite = all(np.all(np.isfinite(part)) for part in (state.x_hat, state.u, state.w_hat))
        return finite and state.history.possible(self.hold_degree) and same_time(state.elapsed, elapsed)

    def estimate(self, state: ObserverState, y: Vector) -> Estimate:
        """Return what is known at a sample y (p,) before any step from it."""
        sample = np.array(y, dtype=float)
        valid = bool(np.all(np.isfinite(sample)))
        residual = sample - self.linear.C @ state.x_hat if valid else np.zeros(len(sample))
        d_hat = self.linear.selector @ (self._unknown_inputs(state.elapsed, residual) if valid else state.w_hat)
        return Estimate(
            x_hat=numbers(state.x_hat),
            d_hat=numbers(d_hat),
            x_at_sample=numbers(state.x_hat),
            d_at_sample=numbers(d_hat),
            d_std=numbers(self._error_bar(state.elapsed)),
            residual=numbers(residual),
            residual_std=(0.0,) * len(residual),
            valid=valid,
        )

    def step(self, state: ObserverState, u: Vector, y: Vector, H: float) -> tuple[ObserverState, Estimate]:
        """Advance by H > 0 s from a sample y (p,), with the input u (m,) held over the step.

        Raises IntegrationError where that takes more than `_MOST_SUBSTEPS`, or the estimate leaves the finite numbers.
        """
        start = self.estimate(state, y)
        inputs = np.array(u, dtype=float)
        if not np.all(np.isfinite(inputs)):
            inputs = state.u
        history = held = state.history
        if start.valid:
            history = history.with_sample(np.array(y, dtype=float), self.hold_degree)
            held = history.chosen(H, self.hold_degree)
        state = replace(state, history=held, u=inputs)

        x_hat = state.x_hat
        substeps = self._substeps(state.elapsed, H)
        h = H / substeps
        for i in range(substeps):
            x_hat = self._substep(state, x_hat, i * h, h, coasting=not start.valid)

        elapsed = state.elapsed + H
        w_hat = state.w_hat
        if start.valid:
            w_hat = self._unknown_inputs(elapsed, held.at(H) - self.linear.C @ x_hat)
        if not (np.all(np.isfinite(x_hat)) and np.all(np.isfinite(w_hat))):
            raise IntegrationError("the observer's estimate leaves the finite numbers")
        after = ObserverState(x_hat=x_hat, elapsed=elapsed, history=history.aged(H), u=inputs, w_hat=w_hat)
        return after, replace(
            start,
            x_hat=numbers(x_hat),
            d_hat=numbers(self.linear.selector @ w_hat),
            d_std=numbers(self._error_bar(elapsed)),
        )

    @cached_property
    def fastest_f(self) -> float:
        """Bound of the rate (1/s) at which G_f f moves the state."""
        return self.linear.f_rate(self.equations.lipschitz)

    def _substeps(self, t: float, H: float) -> int:
        rise = abs(self.schedule.log_pi(t + H) - self.schedule.log_pi(t))
        substeps = max(1.0, H * self.fastest_f / _LARGEST_LIPSCHITZ_STEP, rise / _LARGEST_LOG_PI_STEP)
        if substeps > _MOST_SUBSTEPS:
            raise IntegrationError.report(
                "communication step", expected=f"one of at most {_MOST_SUBSTEPS} substeps", received=f"{H:g} s"
            )
        return ceil(substeps)

    def _unknown_inputs(self, t: float, output_error: Array) -> Array:
        """Return ŵ (q,), eqs. (6) and (23): f(x) − f(x̂) and d where they enter apart, their sum where matched."""
        return self._output_to_w(self.schedule.log_pi(t)) @ output_error

    def _output_to_w(self, log_pi: float) -> Array:
        return self._estimate_gain(
            (log_pi,), lambda: np.exp(0.5 * log_pi) * orthogonal_factor(self.linear, self.table.gain(log_pi))
        )

    def _error_bar(self, t: float) -> Array:
        """Return the noise of a sample times √π, and besides the error that W leaves of a constant |d| = D₀, (q2,)."""
        log_pi = self.schedule.log_pi(t)

        def compute() -> Array:
            linear, L = self.linear, self.table.gain(log_pi)
            gain = linear.selector @ self._output_to_w(log_pi)
            constant = gain @ linear.C @ np.linalg.solve(L @ linear.C - linear.A, linear.G_d)
            bound = np.array(self.disturbance_bound or [0.0] * len(constant))
            noise = np.linalg.norm(gain, axis=1) * self.noise_std
            return np.asarray(np.hypot(noise, np.abs(constant - np.eye(len(constant))) @ bound))

        return self._d_std((log_pi,), compute)

    def _substep(self, state: ObserverState, x_hat: Array, s: float, h: float, *, coasting: bool) -> Array:
        """Return x̂ at s + h after the sample. The gain at the middle is exact; its change is part of N."""
        linear, u = self.linear, state.u.tolist()
        held = linear.B @ state.u
        if coasting:
            forcing = [held + linear.G @ state.w_hat] * 3
            changes: list[Array | None] = [None] * 3
            A_mid = linear.A
            key: tuple[float, ...] = (h,)
        else:
            times = (0.0, 0.5 * h, h)
            log_pis = [self.schedule.log_pi(state.elapsed + s + offset) for offset in times]
            L = [self.table.gain(log_pi) for log_pi in log_pis]
            forcing = [held + L_t @ state.history.at(s + offset) for L_t, offset in zip(L, times, strict=True)]
            moving = log_pis[0] != log_pis[2]
            changes = [(L_t - L[1]) @ linear.C if moving else None for L_t in L]
            A_mid = linear.A - L[1] @ linear.C
            key = (h, log_pis[1])
        step = self._coefficients(key, lambda: exponential_step(A_mid, h, self.table.coordinates))

        def N(x: Array, stage: int) -> Array:
            value = forcing[stage]
            if linear.G_f.size:
                value = value + linear.G_f @ self.equations.nonlinearity(x.tolist(), u, self.parameters)
            change = changes[stage]
            return np.asarray(value if change is None else value - change @ x)

        N_start = N(x_hat, 0)
        first = step.half @ x_hat + step.half_weight @ N_start
        N_first = N(first, 1)
        second = step.half @ x_hat + step.half_weight @ N_first
        N_second = N(second, 1)
        third = step.half @ first + step.half_weight @ (2.0 * N_second - N_start)
        return np.asarray(
            step.full @ x_hat
            + step.start_weight @ N_start
            + step.middle_weight @ (N_first + N_second)
            + step.end_weight @ N(third, 2)
        )


def paper_observer(
    equations: Equations,
    parameters: Vector,
    schedule: PiSchedule,
    *,
    alpha: float,
    hold_degree: int = 2,
    noise_std: float = 0.0,
    disturbance_bound: Vector = (),
) -> PaperObserver:
    """Design the observer for the given parameter values.

    `noise_std` of a sample and `disturbance_bound` D₀ (q2,) go into the error bar only. Raises DesignError where the
    gains cannot be trusted, AssumptionError where α reaches the zeros.
    """
    linear = equations.linear_part(parameters)
    if not (np.isfinite(alpha) and alpha > 0.0):
        raise DesignError.report("alpha", expected="a finite number > 0", received=f"{alpha!r}")
    require_zeros_left_of(linear, alpha)
    return PaperObserver(
        equations=equations,
        parameters=parameters,
        linear=linear,
        schedule=schedule,
        table=gain_table(linear, schedule, alpha=alpha),
        hold_degree=hold_degree,
        noise_std=noise_std,
        disturbance_bound=disturbance_bound,
    )
