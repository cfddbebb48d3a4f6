"""The measurement update: one output at a time, behind the judgement of its sample.

    α = c P cᵀ + R,   K = P cᵀ/α,   ξ̂ += K e,   S ← [S − K (c S), K √R]        with P = S Sᵀ

That is Joseph's form on a factor S. It holds for any gain K, so that the rows of K for parameters which are considered,
but not estimated, may be zero (Schmidt, 1966). An entry that is not finite was not measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.generated_steps import MEMORY, Numbers
from ndob_fmu.runtime.step import adaptive_noise
from ndob_fmu.runtime.step.delayed_outputs import row_in_past
from ndob_fmu.runtime.step.faulty_samples import SUSPICIOUS, judge
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, JumpBank, LagMemory, SampledObserverState, SensorMemory
from ndob_fmu.runtime.step.fixed_lag import smoothed
from ndob_fmu.runtime.step.jump_bank import LONG_AGO, Mixture, accepted, empty_bank, gain, likelihood, mixture

# What a refused sample adds at most to an output's debt, and what a used one leaves of it.
_MOST_DEBT = 10.0
_DEBT_LEFT = 0.5
# Innovations tell of the noise where it makes more than this part of their variance.
_CLEAR = 6.0
# Normalised innovations are averaged over so many samples. What exceeds their mean tells of the noise, the mean of the
# model.
_LATEST = 10.0
_LIMIT = 4.0


@dataclass(frozen=True)
class Measured:
    """The estimate at a sample.

    xi (N + past,): ξ̂, without the mixture's shift.
    factor (N + past,·): of its covariance.
    jumps, sensors, lagged: as in `FilterMemory`.
    mixture: what the hypotheses of a jump add.
    innovation, innovation_std (p,): y − ŷ before the sample was used, 0 where nothing was measured; and what it is
    expected to have.
    sample, squares (p,): as in `SampledObserverState`.
    used (p,): whether the sample of an output was.
    suspicious: whether a sample was far from its prediction.
    """

    xi: Array
    factor: Array
    jumps: JumpBank
    sensors: SensorMemory
    lagged: LagMemory
    mixture: Mixture
    innovation: Array
    innovation_std: Array
    sample: Numbers
    squares: Numbers
    used: NDArray[np.bool_]
    suspicious: bool


def measure(model: FilterModel, xi: Array, state: SampledObserverState, memory: FilterMemory, y: Vector) -> Measured:
    """Update ξ̂⁻ (N + past,) and its covariance with a sample y (p,)."""
    p, sensors, told, u = len(y), memory.sensors, model.noise_variance, state.u
    rows = output_rows(model, xi, memory, u)
    predicted = _predicted(model, xi, u, rows)
    e = [y[i] - predicted[i] if isfinite(y[i]) and rows[i] is not None else 0.0 for i in range(p)]
    ratios = model.noise_ratios(sensors.noise_ratio)
    noise = [float(told[i]) * ratios[i] for i in range(p)]
    spreads = [0.0 if row is None else float(np.sum((row @ memory.factor) ** 2)) for row in rows]
    std = [sqrt(spread + R) for spread, R in zip(spreads, noise, strict=True)]
    measured = [isfinite(y[i]) and rows[i] is not None for i in range(p)]
    repeats = [measured[i] and y[i] == state.sample[i] for i in range(p)]
    judged = memory.age > 0
    stale = judged and any(
        repeats[i] and (abs(e[i]) > SUSPICIOUS * std[i] or bool(sensors.refused[i])) for i in range(p)
    )

    columns = memory.factor.shape[1]
    factor = np.zeros((len(xi), columns + p))
    factor[:, :columns] = memory.factor
    jumps, lagged = memory.jumps, memory.lagged
    evidence, precision, misfit = jumps.evidence, jumps.precision, jumps.misfit
    log_weight = jumps.log_weight
    signatures = jumps.signatures
    prior = xi
    refused, debt = sensors.refused.copy(), sensors.debt.copy()
    skipped, drift = sensors.skipped.copy(), sensors.drift.copy()
    ratio, counted, mean = sensors.noise_ratio.copy(), sensors.counted.copy(), sensors.mean.copy()
    repeat_rate, sample, squares = sensors.repeat_rate.copy(), list(state.sample), list(state.squares)
    used = np.zeros(p, dtype=bool)
    suspicious, fault = False, False
    for i in range(p):
        row = rows[i]
        if not measured[i] or row is None:
            continue
        error = e[i] - float(row @ (xi - prior))
        spread = row @ factor
        alpha = float(spread @ spread) + noise[i]
        squared = error * error / alpha
        if not (stale and repeats[i]):
            mean[i] += (min(max(error / sqrt(alpha), -_LIMIT), _LIMIT) - mean[i]) / _LATEST
        far = squared > SUSPICIOUS**2
        suspicious = suspicious or far
        of_jumps = row @ signatures
        rho = of_jumps.reshape(evidence.shape)
        evidence_if_good = evidence + rho * (error / alpha)
        precision_if_good = precision + rho[:, :, None] * rho[:, None, :] / alpha
        misfit_if_good = misfit + np.array([squared, 1.0])
        if not refused[i]:
            repeat_rate[i] += (repeats[i] - repeat_rate[i]) / MEMORY
        sample[i] = y[i]
        if judged and (far or (stale and repeats[i])):
            again = fault or (bool(refused[i]) and repeats[i])
            verdict = judge(
                squared,
                error,
                alpha,
                noise[i],
                repeats=repeats[i],
                repeat_rate=float(sensors.repeat_rate[i]),
                again=again,
                starting=memory.age < model.start_samples,
            )
            own_spread = float(spread @ spread)
            if verdict.refused and memory.age < model.start_samples and not repeats[i] and own_spread > 0.0:
                # The start is further off than its covariance says, more likely than the sample is.
                growth = sqrt(max((squared * alpha / SUSPICIOUS**2 - noise[i]) / own_spread, 1.0))
                factor, spread = factor * growth, spread * growth
                alpha = growth**2 * own_spread + noise[i]
                squared = error * error / alpha
                verdict = replace(verdict, refused=False)
            refused[i] = verdict.refused
            if verdict.refused:
                fault = True
                if_good = verdict.if_good + 0.5 * squared + likelihood(misfit_if_good) - likelihood(misfit)
                good = if_good + (
                    gain(evidence_if_good, precision_if_good, misfit_if_good, model.jump_precision)
                    - gain(evidence, precision, misfit, model.jump_precision)
                )
                better = good > verdict.if_faulty
                evidence = np.where(better[:, None], evidence_if_good, evidence)
                precision = np.where(better[:, None, None], precision_if_good, precision)
                misfit = np.where(better[:, None], misfit_if_good, misfit)
                log_weight = log_weight + np.where(better, if_good - verdict.if_faulty, 0.0)
                fresh = debt[i] == 0.0
                skipped[i] = error * error if fresh else 0.5 * (skipped[i] + error * error)
                drift[i] = error if fresh else 0.5 * (drift[i] + error)
                if not repeats[i]:
                    debt[i] += min(max(-verdict.if_faulty, 0.0), _MOST_DEBT)
                weight = min(1.0, (_CLEAR * noise[i] / alpha) ** 2)
                counted[i] += weight
                if not stale:
                    product = (error - float(sensors.mean[i]) * sqrt(alpha)) * error
                    ratio[i] = adaptive_noise.averaged(
                        float(ratio[i]), float(counted[i]), product / told[i], alpha / told[i], weight
                    )
                if not repeats[i]:
                    # Little of an outlier is used; more of a sample that only a wrong estimate makes look like one.
                    weak = squared / SUSPICIOUS**2 * alpha
                    K = (factor @ spread) / weak * model.estimated
                    signatures = signatures - K[:, None] * of_jumps
                    lagged = smoothed(lagged, row, K, error, weak)
                    xi = xi + K * error
                    factor = factor - K[:, None] * spread
                    factor[:, columns + i] = K * sqrt(noise[i] + weak - alpha)
                continue
        refused[i] = False
        used[i] = True
        debt[i] *= _DEBT_LEFT
        K = (factor @ spread) / alpha * model.estimated
        evidence, precision, misfit = evidence_if_good, precision_if_good, misfit_if_good
        signatures = signatures - K[:, None] * of_jumps
        lagged = smoothed(lagged, row, K, error, alpha)
        xi = xi + K * error
        factor = factor - K[:, None] * spread
        factor[:, columns + i] = K * sqrt(noise[i])
        squares[i] += (squared - squares[i]) / MEMORY
        weight = min(1.0, (_CLEAR * noise[i] / alpha) ** 2)
        counted[i] += weight
        left = error - float(row @ K) * error
        product = (error - float(sensors.mean[i]) * sqrt(alpha)) * left
        ratio[i] = adaptive_noise.averaged(
            float(ratio[i]), float(counted[i]), product / told[i], alpha / told[i], weight
        )
    bank = JumpBank(
        signatures, evidence, precision, misfit, log_weight, jumps.newest_age, min(jumps.since_jump + 1, LONG_AGO)
    )
    change = np.abs(np.array(y) - np.array(state.sample))
    resolution, alike = adaptive_noise.smallest_change(sensors.resolution, sensors.alike, change)
    ratio = np.maximum(ratio, adaptive_noise.of_rounding(resolution, alike, repeat_rate) / told)
    sensors = replace(
        sensors,
        resolution=resolution,
        alike=alike,
        noise_ratio=ratio if memory.age > model.layout.size else sensors.noise_ratio,
        counted=counted if memory.age > model.layout.size else sensors.counted,
        repeat_rate=repeat_rate,
        refused=refused,
        debt=debt,
        skipped=skipped,
        drift=drift,
        mean=mean,
        waited=np.where(used, 0.0, sensors.waited),
        interval=np.where(used, np.maximum(sensors.waited, sensors.interval * (1.0 - 0.5 / MEMORY)), sensors.interval),
    )
    added = mixture(bank, model.jump_precision)
    if added.certain:
        shift, more = accepted(bank, model.jump_precision)
        xi = xi + shift
        columns_of_series = model.start_columns if bank.since_jump < LONG_AGO else np.zeros_like(model.start_columns)
        factor = np.hstack([factor, more, columns_of_series])
        bank = replace(empty_bank(len(xi), model.layout.q), since_jump=0)
        # What looked like an outlier was the jump, whose size it has told.
        used = np.array(measured)
        sensors = replace(
            sensors,
            mean=np.zeros(p),
            debt=np.zeros(p),
            refused=np.zeros(p, dtype=bool),
            waited=np.where(used, 0.0, sensors.waited),
        )
        added = mixture(bank, model.jump_precision)
    return Measured(
        xi=xi,
        factor=factor,
        jumps=bank,
        sensors=sensors,
        lagged=lagged,
        mixture=added,
        innovation=np.array(e),
        innovation_std=np.array(std),
        sample=tuple(sample),
        squares=tuple(squares),
        used=used,
        suspicious=suspicious,
    )


def predicted_sample(model: FilterModel, state: SampledObserverState, y: Vector) -> tuple[Array, Array]:
    """Return y − ŷ (p,), 0 where nothing was measured, and the standard deviations (p,) that it should have."""
    xi = np.concatenate([model.layout.unpacked(state.xi_hat), state.memory.past])
    rows = output_rows(model, xi, state.memory, state.u)
    predicted = _predicted(model, xi, state.u, rows)
    innovation, std = np.zeros(len(y)), np.zeros(len(y))
    for i, row in enumerate(rows):
        spread = 0.0 if row is None else float(np.sum((row @ state.memory.factor) ** 2))
        std[i] = sqrt(spread + model.noise_variance[i])
        if isfinite(y[i]) and row is not None:
            innovation[i] = y[i] - predicted[i]
    return innovation, std


def bounded(model: FilterModel, xi: Array, factor: Array) -> tuple[Array, Array]:
    """Return ξ̂ and the factor with what |d| ≤ D₀ adds where d is known no better than by that.

    The bound counts as a measurement of d = 0 that leaves the standard deviation D₀.
    """
    for j, bound in enumerate((model.bound * model.scale).tolist() if model.layout.order else ()):
        place = model.layout.n + j
        seen = factor[place]
        variance = float(seen @ seen)
        if variance > bound * bound:
            noise = variance * bound**2 / (variance - bound**2)
            K = (factor @ seen) / (variance + noise) * model.estimated
            xi = xi - K * xi[place]
            factor = np.column_stack([factor - K[:, None] * seen, K * sqrt(noise)])
    return xi, factor


def output_rows(model: FilterModel, xi: Array, memory: FilterMemory, u: Vector) -> list[Array | None]:
    """Return the row (N + past,) of each output; None where its sensor measured a time before the start."""
    C = model.slopes(xi, u).C
    rows: list[Array | None] = []
    for i, tau in enumerate(model.settings.sensors.delay):
        now = np.zeros(model.rows)
        now[: model.layout.size] = C[i]
        if tau > 0.0:
            which = model.delayed.index(i)
            rows.append(row_in_past(memory.past_age, tau, now, which, len(model.delayed)))
        else:
            rows.append(now)
    return rows


def _predicted(model: FilterModel, xi: Array, u: Vector, rows: list[Array | None]) -> Array:
    predicted = model.predicted_output(xi, u)
    for i in model.delayed:
        row = rows[i]
        if row is not None:
            # The last node of the interpolation is the output at this sample, as far as the row has entries there.
            share = 1.0 - float(np.sum(row[model.layout.size :]))
            predicted[i] = share * predicted[i] + float(row[model.layout.size :] @ xi[model.layout.size :])
    return predicted
