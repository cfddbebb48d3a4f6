"""The measurement update: one output at a time, behind the judgement of its sample.

    α = c P cᵀ + R,   K = P cᵀ/α,   ξ̂ += K e,   S ← [S − K (c S), K √R]        with P = S Sᵀ

That is Joseph's form on a factor S. It holds for any gain K, so that the rows of K for parameters which are considered,
but not estimated, may be zero (Schmidt, 1966). An entry that is not finite was not measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt
from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.generated_steps import MEMORY, Numbers
from ndob_fmu.runtime.step.error_columns import ErrorColumns, joined
from ndob_fmu.runtime.step.faulty_samples import SUSPICIOUS, is_stuck, judge
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, JumpBank, LagMemory, SampledObserverState, SensorMemory
from ndob_fmu.runtime.step.fixed_lag import moved, smoothed, without_signatures
from ndob_fmu.runtime.step.jump_bank import (
    LONG_AGO,
    Mixture,
    accepted,
    after_certain_jump,
    explained,
    if_refused,
    if_used,
    mixture,
    one_more_sample,
)
from ndob_fmu.runtime.step.prediction import Prediction, predicted
from ndob_fmu.runtime.step.sensor_memory import (
    SETTLED,
    Innovation,
    after_jump,
    after_refused,
    after_used,
    goes_on,
    in_a_row,
    is_still_broken,
    latest_mean,
)


@dataclass(frozen=True)
class Measured:
    """The estimate at a sample.

    xi (N + past,): ξ̂, without the mixture's shift.
    columns, jumps, lagged: as in `FilterMemory`; sensors (p,): as there.
    mixture: what the hypotheses of a jump add.
    prediction: of the sample.
    sample, squares (p,): as in `SampledObserverState`.
    used (p,): whether the sample of an output was.
    suspicious: whether a sample was far from its prediction.
    """

    xi: Array
    columns: ErrorColumns
    jumps: JumpBank
    lagged: LagMemory
    sensors: tuple[SensorMemory, ...]
    mixture: Mixture
    prediction: Prediction
    sample: Numbers
    squares: Numbers
    used: list[bool]
    suspicious: bool


class _Estimate(NamedTuple):
    """The estimate while the samples of one output after another come in; the fields as in `Measured`."""

    xi: Array
    columns: ErrorColumns
    jumps: JumpBank
    lagged: LagMemory


class _Sight(NamedTuple):
    """An output's sample beside the estimate.

    row (N + past,): of the output
    across: the row times all columns
    e, alpha: the innovation and its variance
    noise: the variance of the noise
    squared: e²/α
    """

    row: Array
    across: Array
    e: float
    alpha: float
    noise: float
    squared: float


def measure(model: FilterModel, xi: Array, state: SampledObserverState, memory: FilterMemory, y: Vector) -> Measured:
    """Update ξ̂⁻ (N + past,) and its covariance with a sample y (p,)."""
    p, variances = len(y), model.noise_variance.tolist()
    prediction = predicted(model, xi, memory, state.u, y)
    starting = memory.age < model.start_samples
    # The sample that ends a stretch with a frozen gain is there because it is unusual, and would not be a fair one.
    learns = memory.age > model.layout.size and not memory.converged
    repeats = [one and y[i] == state.sample[i] for i, one in enumerate(prediction.measured)]
    alike = [in_a_row(memory.sensors[i], prediction.noise[i]) if repeats[i] else 0.0 for i in range(p)]
    stale = memory.age > 0 and any(
        repeats[i]
        and (
            abs(prediction.innovation[i]) > SUSPICIOUS * prediction.std[i]
            or memory.sensors[i].refused
            or is_stuck(alike[i])
        )
        for i in range(p)
    )
    columns = memory.columns.with_room(p)
    now = _Estimate(xi, columns, memory.jumps, memory.lagged)
    sensors, sample, squares = list(memory.sensors), list(state.sample), list(state.squares)
    used, suspicious, fault = [False] * p, False, False
    for i, row in enumerate(prediction.rows):
        if row is None or not prediction.measured[i]:
            continue
        sample[i] = y[i]
        place, stuck = columns.factor_count - p + i, stale and repeats[i]
        e = prediction.innovation[i] - (float(row @ (now.xi - xi)) if now.xi is not xi else 0.0)
        seen = _sight(row, now.columns, e, prediction.noise[i])
        told = explained(now.jumps, _of_jumps(now, seen), seen.e, seen.alpha)
        far = seen.squared > SUSPICIOUS**2
        suspicious = suspicious or far
        before, change = sensors[i], y[i] - state.sample[i]
        # Where no other sensor agrees with the estimate, it may as well be that one that is wrong.
        agreed = any(not other.refused for j, other in enumerate(memory.sensors) if j != i)
        broken = agreed and is_still_broken(before, y[i], change, seen.e, seen.noise)
        mean = before.mean if stuck or broken else latest_mean(before, seen.e, seen.alpha)
        refused = None
        if memory.age > 0 and (far or stuck or broken):
            verdict = judge(
                seen.squared,
                seen.e,
                seen.alpha,
                seen.noise,
                repeats=repeats[i],
                repeat_rate=min(before.repeat_rate, exp(alike[i])),
                outlier_rate=before.outlier_rate,
                doubtful=before.doubtful,
                again=fault or (before.refused and repeats[i]),
                starting=starting,
                broken=broken,
                settled=broken and before.debt >= SETTLED,
                change=change,
            )
            if verdict.refused and starting and not repeats[i] and seen.alpha > seen.noise:
                now, seen = _with_larger_error(model, now, seen)
            elif verdict.refused and (repeats[i] or broken or not goes_on(before, seen.e, seen.alpha)):
                refused, fault = verdict, True
        tells = Innovation(
            e=seen.e,
            alpha=seen.alpha,
            noise=seen.noise,
            told=variances[i],
            mean=mean,
            value=y[i],
            change=change,
            repeats=repeats[i],
            learns=learns,
        )
        if refused is None:
            now, K = _corrected(
                model, _Estimate(now.xi, now.columns, if_used(now.jumps, told), now.lagged), seen, place
            )
            used[i] = True
            squares[i] += (seen.squared - squares[i]) / MEMORY
            sensors[i] = after_used(before, tells, seen.e - float(row @ K) * seen.e)
        else:
            now = now._replace(
                jumps=if_refused(now.jumps, told, refused.if_good + 0.5 * seen.squared, refused.if_faulty)
            )
            if not (repeats[i] or broken):
                # Little of an outlier is used; more of a sample that only a wrong estimate makes look like one.
                weak = seen.squared / SUSPICIOUS**2 * seen.alpha
                now, _ = _corrected(model, now, seen, place, weak - seen.alpha)
            sensors[i] = after_refused(before, tells, refused.if_faulty, stuck=stale, broken=broken)
    now = now._replace(jumps=one_more_sample(now.jumps))
    added = mixture(now.jumps, now.columns.signatures)
    if added.certain:
        now = _with_jump(model, now)
        used = [
            one and not is_stuck(alike[i]) and (_is_explained(now, xi, prediction, i) or not sensors[i].broken)
            for i, one in enumerate(prediction.measured)
        ]
        sensors = [after_jump(sensor, used=one) for sensor, one in zip(sensors, used, strict=True)]
        added = mixture(now.jumps, now.columns.signatures)
    return Measured(
        xi=now.xi,
        columns=now.columns,
        jumps=now.jumps,
        lagged=now.lagged,
        sensors=tuple(sensors),
        mixture=added,
        prediction=prediction,
        sample=tuple(sample),
        squares=tuple(squares),
        used=used,
        suspicious=suspicious,
    )


def _sight(row: Array, columns: ErrorColumns, e: float, noise: float) -> _Sight:
    across = row @ columns.values
    of_factor = across[: columns.factor_count]
    alpha = float(of_factor @ of_factor) + noise
    return _Sight(row, across, e, alpha, noise, e * e / alpha)


def _is_explained(now: _Estimate, before: Array, prediction: Prediction, i: int) -> bool:
    """Return whether the estimate with a jump explains the sample of an output, predicted from ξ̂ before (rows,)."""
    row = prediction.rows[i]
    if row is None:
        return False
    e = prediction.innovation[i] - float(row @ (now.xi - before))
    return _sight(row, now.columns, e, prediction.noise[i]).squared <= SUSPICIOUS**2


def _of_jumps(now: _Estimate, seen: _Sight) -> Array:
    start = now.columns.factor_count
    return seen.across[start : start + now.columns.jump_count]


def _corrected(
    model: FilterModel, now: _Estimate, seen: _Sight, place: int, more_noise: float = 0.0
) -> tuple[_Estimate, Array]:
    """Return the estimate corrected by a sample with so much more noise, and the gain (rows,)."""
    columns, count = now.columns, now.columns.factor_count
    alpha = seen.alpha + more_noise
    K = (columns.factor @ seen.across[:count]) / alpha
    if model.considers:
        K = K * model.estimated
    values = columns.values - K[:, None] * seen.across
    values[:, place] = K * sqrt(seen.noise + more_noise)
    seen_past = seen.across[count + columns.jump_count :]
    lagged = smoothed(now.lagged, seen_past, _of_jumps(now, seen), seen.e, alpha)
    return _Estimate(now.xi + K * seen.e, columns.with_values(values), now.jumps, lagged), K


def _with_larger_error(model: FilterModel, now: _Estimate, seen: _Sight) -> tuple[_Estimate, _Sight]:
    """Return an estimate that is further off than its covariance says, which at the start is likelier than a fault."""
    columns, count = now.columns, now.columns.factor_count
    spread = seen.alpha - seen.noise
    growth = sqrt(max((seen.squared * seen.alpha / SUSPICIOUS**2 - seen.noise) / spread, 1.0))
    values = columns.values.copy()
    values[:, :count] *= model.growths(growth)[:, None]
    grown = columns.with_values(values)
    return now._replace(columns=grown), _sight(seen.row, grown, seen.e, seen.noise)


def _with_jump(model: FilterModel, now: _Estimate) -> _Estimate:
    """Return the estimate with a jump that is certain, and a bank without hypotheses.

    A second jump soon after another means that the derivatives of d are unknown again.
    """
    rows = len(now.xi)
    both = np.concatenate([now.columns.signatures, now.lagged.signatures])
    shift, all_more = accepted(now.jumps, both)
    more, of_past = all_more[:rows], all_more[rows:]
    lagged = moved(without_signatures(now.lagged), shift[rows:], (of_past**2).sum(axis=1))
    covariance = now.columns.covariance + more @ of_past.T
    if now.jumps.since_jump < LONG_AGO:
        more = np.concatenate([more, model.unknown_disturbance], axis=1)
    columns = now.columns.more(more)
    nothing = np.zeros_like(columns.signatures)
    return now._replace(
        xi=now.xi + shift[:rows],
        columns=joined(columns.factor, nothing, covariance),
        lagged=lagged,
        jumps=after_certain_jump(now.jumps, model.bound),
    )


def bounded(
    model: FilterModel, xi: Array, columns: ErrorColumns, lagged: LagMemory, more: Array
) -> tuple[Array, ErrorColumns, LagMemory]:
    """Return ξ̂, columns and past with what |d − nominal| ≤ D₀ adds where d is known no better than by that.

    The bound counts as a measurement of the nominal d that leaves the standard deviation D₀. It does not move with a
    jump, so that signatures stay.

    more (q2,): variance that parameters add to D₀², as `FilterModel.taken_for_disturbance`
    """
    limits = (model.bound * model.scale) ** 2 + more
    for j, limit in enumerate(limits.tolist() if model.layout.order else ()):
        place, factor = model.layout.n + j, columns.factor
        seen = factor[place]
        variance = float(seen @ seen)
        if variance > limit:
            noise = variance * limit / (variance - limit)
            K = (factor @ seen) / (variance + noise) * model.estimated
            e = model.settings.disturbance_nominal[j] - xi[place]
            past = columns.covariance
            lagged = smoothed(lagged, past[place], np.zeros(columns.jump_count), e, variance + noise)
            xi = xi + K * e
            factor = np.column_stack([factor - K[:, None] * seen, K * sqrt(noise)])
            columns = joined(factor, columns.signatures, past - K[:, None] * past[place])
    return xi, columns, lagged
