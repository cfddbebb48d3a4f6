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
from ndob_fmu.runtime.design.minimum_phase import require_zeros_left_of
from ndob_fmu.runtime.design.schedule import PiSchedule, gain_table
from ndob_fmu.runtime.design.scheduled_gains import ScheduledGains
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.memo import LatestResult
from ndob_fmu.runtime.numerics.exponential import ExponentialStep, exponential_step
from ndob_fmu.runtime.numerics.hold import History, empty_history
from ndob_fmu.runtime.step.observer import Estimate, numbers

_MOST_SUBSTEPS = 10_000  # in one communication step
# The explicit part of the integration stays accurate while f and ln π change this little over one substep.
_LARGEST_LIPSCHITZ_STEP = 0.5
_LARGEST_LOG_PI_STEP = 0.1


@dataclass(frozen=True)
class PaperObserverState:
    """All that the observer remembers.

    x_hat (n,): x̂.
    elapsed: s since the start.
    history: past samples.
    u (m,): the last finite input.
    w_hat (q,): the last estimate ŵ.
    """

    x_hat: Array
    elapsed: float
    history: History
    u: Array
    w_hat: Array


@dataclass(frozen=True)
class PaperObserver:
    """The observer at given parameters. It remembers nothing between steps but in the state.

    gains: as functions of π along its schedule
    nominal (q2,): value about which d is small
    hold_degree: of the polynomial through the last samples that stands for y(t) within a step
    """

    equations: Equations
    parameters: Vector
    gains: ScheduledGains
    nominal: Array
    hold_degree: int = 2
    # Those of the last substep, which stay the same once π is constant.
    _coefficients: LatestResult[ExponentialStep] = field(default_factory=LatestResult, repr=False, compare=False)

    @property
    def linear(self) -> LinearPart:
        """The plant's matrices."""
        return self.gains.linear

    def init(self, x_hat: Vector) -> PaperObserverState:
        """Return the state that starts from x̂₀ (n,)."""
        return PaperObserverState(
            x_hat=np.array(x_hat, dtype=float),
            elapsed=0.0,
            history=empty_history(len(self.linear.C)),
            u=np.zeros(self.linear.B.shape[1]),
            w_hat=np.zeros(self.linear.G.shape[1]),
        )

    def possible(self, state: PaperObserverState) -> bool:
        """Return whether numbers in the form of a state can be one."""
        finite = all(np.all(np.isfinite(part)) for part in (state.x_hat, state.u, state.w_hat))
        return finite and state.history.possible(self.hold_degree) and 0.0 <= state.elapsed < np.inf

    def estimate(self, state: PaperObserverState, y: Vector) -> Estimate:
        """Return what is known at a sample y (p,) before any step from it."""
        sample = np.array(y, dtype=float)
        valid = bool(np.all(np.isfinite(sample)))
        residual = sample - self.linear.C @ state.x_hat if valid else np.zeros(len(sample))
        d_hat = self._disturbance(self._unknown_inputs(state.elapsed, residual) if valid else state.w_hat)
        return Estimate(
            x_hat=numbers(state.x_hat),
            d_hat=numbers(d_hat),
            x_at_sample=numbers(state.x_hat),
            d_at_sample=numbers(d_hat),
            d_std=numbers(self._error_bar(state.elapsed)),
            d_lagged=numbers(d_hat),
            d_lagged_std=numbers(self._error_bar(state.elapsed)),
            residual=numbers(residual),
            residual_std=(0.0,) * len(residual),
            valid=valid,
            consistency=0.0,
        )

    def step(self, state: PaperObserverState, u: Vector, y: Vector, H: float) -> tuple[PaperObserverState, Estimate]:
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
        after = PaperObserverState(x_hat=x_hat, elapsed=elapsed, history=history.aged(H), u=inputs, w_hat=w_hat)
        return after, replace(
            start,
            x_hat=numbers(x_hat),
            d_hat=numbers(self._disturbance(w_hat)),
            d_std=numbers(self._error_bar(elapsed)),
        )

    @cached_property
    def fastest_f(self) -> float:
        """Bound of the rate (1/s) at which G_f f moves the state."""
        return self.linear.f_rate(self.equations.lipschitz)

    def _substeps(self, t: float, H: float) -> int:
        schedule = self.gains.schedule
        rise = abs(schedule.log_pi(t + H) - schedule.log_pi(t))
        substeps = max(1.0, H * self.fastest_f / _LARGEST_LIPSCHITZ_STEP, rise / _LARGEST_LOG_PI_STEP)
        if substeps > _MOST_SUBSTEPS:
            raise IntegrationError.report(
                "communication step", expected=f"one of at most {_MOST_SUBSTEPS} substeps", received=f"{H:g} s"
            )
        return ceil(substeps)

    def _unknown_inputs(self, t: float, output_error: Array) -> Array:
        """Return ŵ (q,), eqs. (6) and (23): f(x) − f(x̂) and d where they enter apart, their sum where matched."""
        return self.gains.output_to_w(self.gains.schedule.log_pi(t)) @ output_error

    def _disturbance(self, w_hat: Array) -> Array:
        return np.asarray(self.linear.selector @ w_hat + self.nominal)

    def _error_bar(self, t: float) -> Array:
        return self.gains.disturbance_std(self.gains.schedule.log_pi(t))

    def _substep(self, state: PaperObserverState, x_hat: Array, s: float, h: float, *, coasting: bool) -> Array:
        """Return x̂ at s + h after the sample. The gain at the middle is exact; its change is part of N."""
        linear, table, u = self.linear, self.gains.table, state.u.tolist()
        held = linear.B @ state.u + linear.G_d @ self.nominal
        if coasting:
            forcing = [held + linear.G @ state.w_hat] * 3
            changes: list[Array | None] = [None] * 3
            A_mid = linear.A
            key: tuple[float, ...] = (h,)
        else:
            times = (0.0, 0.5 * h, h)
            log_pis = [self.gains.schedule.log_pi(state.elapsed + s + offset) for offset in times]
            L = [table.gain(log_pi) for log_pi in log_pis]
            forcing = [held + L_t @ state.history.at(s + offset) for L_t, offset in zip(L, times, strict=True)]
            moving = log_pis[0] != log_pis[2]
            changes = [(L_t - L[1]) @ linear.C if moving else None for L_t in L]
            A_mid = linear.A - L[1] @ linear.C
            key = (h, log_pis[1])
        step = self._coefficients(key, lambda: exponential_step(A_mid, h, table.coordinates))

        def N(x: Array, stage: int) -> Array:
            value = forcing[stage]
            if linear.G_f.size:
                value = value + linear.G_f @ self.equations.nonlinearity(x.tolist(), u, self.parameters)
            change = changes[stage]
            return np.asarray(value if change is None else value - change @ x)

        return step.advance(x_hat, N)


def paper_observer(
    equations: Equations,
    parameters: Vector,
    schedule: PiSchedule,
    *,
    alpha: float,
    hold_degree: int = 2,
    noise_std: Vector = (),
    disturbance_bound: Vector = (),
    disturbance_nominal: Vector = (),
) -> PaperObserver:
    """Design the observer for the given parameter values.

    noise_std (p,): σ of a sample of each output, for the error bar only
    disturbance_bound (q2,): D₀, for the error bar only
    disturbance_nominal (q2,): value about which d is small; 0 if it is empty

    Raises DesignError where the gains cannot be trusted, AssumptionError where α reaches the zeros.
    """
    linear = equations.linear_part(parameters)
    if not (np.isfinite(alpha) and alpha > 0.0):
        raise DesignError.report("alpha", expected="a finite number > 0", received=f"{alpha!r}")
    require_zeros_left_of(linear, alpha)
    return PaperObserver(
        equations=equations,
        parameters=parameters,
        gains=ScheduledGains(
            linear=linear,
            schedule=schedule,
            table=gain_table(linear, schedule, alpha=alpha),
            noise_std=noise_std,
            disturbance_bound=disturbance_bound,
        ),
        nominal=np.array(disturbance_nominal, dtype=float) if disturbance_nominal else np.zeros(linear.G_d.shape[1]),
        hold_degree=hold_degree,
    )
