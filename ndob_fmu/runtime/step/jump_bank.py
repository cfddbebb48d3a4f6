"""Jumps of the disturbance: a bank of hypotheses, two for each of the last steps (Willsky and Jones, 1976).

A jump of d adds μ ν to the error of ξ̂, with μ the response to a jump of one. The first hypothesis is a jump at the
sample. The second is one inside the step; it stands as jumps at the three nodes of Gauss and Legendre, of independent
sizes with the variances w_i V, which gives the covariance of a jump at any instant. The filter that does not know it
has innovations e of the variance α and the mean ρᵀν. A small Kalman filter for ν, on a factor U of its covariance
(Potter's form), follows the sizes; that of the hypothesis is the one filter plus a correction:

    f = Uᵀρ,   s = α + fᵀf,   r = e − ρᵀν̂,   ν̂ += U f r/s,   U −= U f fᵀ/(s + √(α s)),   ξ̂ + M ν̂,   P + M U (M U)ᵀ

The weight over no jump is p L(Σ r²/s)/L(Σ e²/α) Π √(α/s). L is Student's density, because α is not sure: innovations
that are all too large speak for a larger noise, not for a jump.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.transition import parts_of
from ndob_fmu.runtime.step.filter_state import JumpBank

# Before the first sample, jumps are expected in this share of the samples; later as often as they were in about so many
# samples, but within these limits.
FIRST_RATE = 0.003
_RATE_MEMORY, _LEAST, _MOST = 1000.0, 3e-4, 0.005
_SHARES = np.array([0.7, 0.3])  # at the sample, within the step
# A jump may be as large as from one bound to the other: V = 2 D₀².
_VARIANCE = 2.0
# The variance of a jump that does not show, over D₀²: one between any two values within half the bounds.
_UNSEEN_VARIANCE = 1.0 / 6.0
LENGTH = 12
# The instants of a jump, in parts of the step, and their weights.
INSTANTS = (0.0, 0.5 - 0.15**0.5, 0.5, 0.5 + 0.15**0.5)
AFTER_JUMPS = parts_of([1.0 - instant for instant in INSTANTS])
_NODES = 3
_WEIGHTS = np.array([[1.0, 0.0, 0.0], [5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0]])
_KINDS = len(_WEIGHTS)
# Signatures of one step and disturbance: of the first kind, and of the nodes of the second one.
_INSTANTS = len(INSTANTS)
# Hypotheses of less weight are not worth a correction; those of more replace the filter's state.
_MENTIONED, _CERTAIN = 0.4, 0.95
# The variances of the innovations are as sure as if so many innovations had told them.
_SURE = 20.0
# Without evidence, a jump before more samples than these would have shown.
_UNSEEN = 3
# A second jump within so many samples means that the derivatives of d have changed too.
LONG_AGO = 24
_LONG = 1e9  # s


@dataclass(frozen=True)
class Mixture:
    """What the hypotheses add to the estimate.

    shift (rows,): mean of the correction of ξ̂; None where it is zero.
    variance (rows,): its variance.
    certain: whether there was a jump.
    """

    shift: Array | None
    variance: Array | None
    certain: bool


_NOTHING = Mixture(None, None, certain=False)


class Explained(NamedTuple):
    """What an innovation says under each hypothesis.

    sizes, misfit: as in `JumpBank`, afterwards.
    gained (2 L q2,): what it adds to `log_weight`.
    """

    sizes: Array
    misfit: Array
    gained: Array


def empty_bank(disturbance_bound: Array, rate: float) -> JumpBank:
    """Return a bank without hypotheses, for D₀ (q2,).

    rate: as in `JumpBank`
    """
    sizes = np.tile(first_sizes(disturbance_bound), (LENGTH, 1, 1))
    return JumpBank(
        sizes=sizes,
        misfit=np.zeros((3, len(sizes))),
        log_weight=np.full(len(sizes), -np.inf),
        newest_age=np.inf,
        since_jump=LONG_AGO,
        rate=rate,
    )


def columns_of(q: int) -> int:
    """Return how many signatures a bank for q disturbances has."""
    return LENGTH * q * _INSTANTS


def full_bank(disturbance_bound: Array, rate: float) -> JumpBank:
    """Return a bank of all hypotheses, without evidence, for D₀ (q2,).

    rate: as in `JumpBank`
    """
    bank = empty_bank(disturbance_bound, rate)
    weights = _expected_weights(rate, len(bank.log_weight))
    weights[: -_UNSEEN * len(weights) // LENGTH] = -np.inf
    return replace(bank, log_weight=weights, newest_age=0.0)


def _expected_weights(rate: float, count: int) -> Array:
    """Return the logarithms of the weights (count,) of hypotheses before any evidence."""
    probable = min(max(rate, _LEAST), _MOST)
    return np.asarray(np.tile(np.log(probable * _SHARES), count // _KINDS))


def unseen_variance(bank: JumpBank, disturbance_bound: Array) -> Array:
    """Return the variance (q2,) that jumps add to d in a step in which none would show, for D₀ (q2,)."""
    return np.asarray(min(max(bank.rate, _LEAST), _MOST) * _UNSEEN_VARIANCE * disturbance_bound**2)


def first_sizes(disturbance_bound: Array) -> Array:
    """Return [U, ν̂] (2 q2,3,4) of the hypotheses of one step before any evidence, for D₀ (q2,)."""
    std = np.sqrt(_VARIANCE * _WEIGHTS) * disturbance_bound[:, None, None]
    return np.asarray(std.reshape(-1, _NODES)[:, :, None] * np.eye(_NODES, _NODES + 1))


def explained(bank: JumpBank, of_jumps: Array, e: float, alpha: float) -> Explained:
    """Return what an innovation e of the variance α says, where jumps of one add `of_jumps` (4 L q2,) to it."""
    sizes, misfit, gained = with_innovation(bank.sizes, bank.misfit, of_jumps, e, alpha)
    return Explained(sizes, misfit, gained)


def with_innovation(sizes: Array, misfit: Array, of_jumps: Array, e: float, alpha: float) -> tuple[Array, Array, Array]:
    """Return the fields of `Explained`; see `explained`."""
    rho = _of_kinds(of_jumps[None])[0]
    both = (rho[:, None] @ sizes)[:, 0]
    f, r = both[:, :_NODES], e - both[:, _NODES]
    s = (f * f).sum(axis=1) + alpha
    share: Array = np.empty_like(both)
    share[:, :_NODES] = f / (s + np.sqrt(alpha * s))[:, None]
    share[:, _NODES] = -r / s
    misfit = misfit.copy()
    misfit[0] += e * e / alpha
    misfit[1] += r * r / s
    misfit[2] += 1.0
    along = sizes[:, :, :_NODES] @ f[:, :, None]
    return sizes - along * share[:, None, :], misfit, -0.5 * np.log(s / alpha)


def if_used(bank: JumpBank, told: Explained) -> JumpBank:
    """Return the bank after a sample that is good."""
    return JumpBank(told.sizes, told.misfit, bank.log_weight + told.gained, bank.newest_age, bank.since_jump, bank.rate)


def if_refused(bank: JumpBank, told: Explained, if_good: float, if_faulty: float) -> JumpBank:
    """Return the bank after a sample that the filter refuses; a hypothesis that explains it better uses it.

    if_good, if_faulty: logarithms of the sample's probability without a jump, but for its innovation if it is good
    """
    without, within = _likelihood(bank.misfit), _likelihood(told.misfit)
    better = if_good + within[1] - without[1] + told.gained > if_faulty
    instead = told.gained + (if_good + within[0] - without[0] - if_faulty)
    return JumpBank(
        np.where(better[:, None, None], told.sizes, bank.sizes),
        np.where(better, told.misfit, bank.misfit),
        bank.log_weight + np.where(better, instead, 0.0),
        bank.newest_age,
        bank.since_jump,
        bank.rate,
    )


def _likelihood(misfit: Array) -> Array:
    """Return the logarithm of Student's density over its peak (2,2 L q2), without and with a jump."""
    return np.asarray((misfit[2] + _SURE) * -0.5 * np.log1p(misfit[:2] * (1.0 / _SURE)))


def log_weights(bank: JumpBank) -> Array:
    """Return the logarithm of the weights (2 L q2,) of the hypotheses over that of no jump."""
    without, within = _likelihood(bank.misfit)
    return np.asarray(bank.log_weight + within - without)


def one_more_sample(bank: JumpBank) -> JumpBank:
    """Return the bank after all outputs of a sample."""
    rate = bank.rate * (1.0 - 1.0 / _RATE_MEMORY)
    return JumpBank(bank.sizes, bank.misfit, bank.log_weight, bank.newest_age, min(bank.since_jump + 1, LONG_AGO), rate)


def later_bank(bank: JumpBank, H: float) -> JumpBank:
    """Return the bank H s later."""
    return JumpBank(
        bank.sizes, bank.misfit, bank.log_weight, min(bank.newest_age + H, _LONG), bank.since_jump, bank.rate
    )


def after_certain_jump(bank: JumpBank, disturbance_bound: Array) -> JumpBank:
    """Return the bank after a jump that is certain, for D₀ (q2,)."""
    return replace(empty_bank(disturbance_bound, bank.rate + 1.0 / _RATE_MEMORY), since_jump=0)


def mixture(bank: JumpBank, signatures: Array) -> Mixture:
    """Return mean and variance of the correction by all hypotheses, no jump included, for signatures (rows,4 L q2)."""
    of_each = log_weights(bank)
    # So little weight stays below the limit even if all hypotheses have it.
    if float(of_each.max()) < log(_MENTIONED / (1.0 - _MENTIONED) / len(bank.log_weight)):
        return _NOTHING
    weights, _ = _normalised(of_each)
    total = float(weights.sum())
    if total <= _MENTIONED:
        return _NOTHING
    shift, variance = _moments(bank, weights, signatures)
    best = int(np.argmax(weights))
    # The first sample after a jump cannot tell its size from its instant.
    settled = best < len(weights) - len(weights) // LENGTH
    return Mixture(shift, variance, certain=total > _CERTAIN and settled)


def moments(bank: JumpBank, signatures: Array) -> tuple[Array, Array]:
    """Return what `mixture` does, mean and variance (rows,), whatever the weights."""
    weights, _ = _normalised(log_weights(bank))
    return _moments(bank, weights, signatures)


def _moments(bank: JumpBank, weights: Array, signatures: Array) -> tuple[Array, Array]:
    each, within = _of_each(bank, signatures)
    shift = each @ weights
    return shift, np.maximum(((within**2).sum(axis=2) + each**2) @ weights - shift**2, 0.0)


def accepted(bank: JumpBank, signatures: Array) -> tuple[Array, Array]:
    """Return what a jump that is certain adds to ξ̂ (rows,), and the columns (rows,·) that it adds to the factor of P.

    Mean and covariance are those of all hypotheses together, that of no jump included, because no instant is certain.
    """
    weights, none = _normalised(log_weights(bank))
    each, within = _of_each(bank, signatures)
    shift, roots = each @ weights, np.sqrt(weights)
    between = np.column_stack([(each - shift[:, None]) * roots, -shift * sqrt(none)])
    return shift, np.hstack([(within * roots[:, None]).reshape(len(shift), -1), between])


def _normalised(of_each: Array) -> tuple[Array, float]:
    """Return the weights (2 L q2,) of the hypotheses and that of no jump, which are one together."""
    top = max(float(of_each.max()), 0.0)
    weights = np.exp(of_each - top)
    none = exp(-top)
    total = none + float(weights.sum())
    return np.asarray(weights / total), none / total


def _of_each(bank: JumpBank, signatures: Array) -> tuple[Array, Array]:
    """Return the corrections (rows,2 L q2) of the hypotheses, and factors (rows,2 L q2,3) of their covariances."""
    both = np.einsum("rhk,hkj->rhj", _of_kinds(signatures), bank.sizes)
    return both[:, :, _NODES], both[:, :, :_NODES]


def _of_kinds(signatures: Array) -> Array:
    """Return the signatures (rows,2 L q2,3) of the nodes of each hypothesis; a jump at the sample has one node."""
    each = signatures.reshape(len(signatures), -1, _INSTANTS)
    of_each = np.zeros((len(each), each.shape[1], _KINDS * _NODES))
    of_each[:, :, 0] = each[:, :, 0]
    of_each[:, :, _NODES:] = each[:, :, 1:]
    return of_each.reshape(len(each), -1, _NODES)


def with_newest(bank: JumpBank, newest: Array) -> JumpBank:
    """Return the bank with the hypotheses of a jump in this step in place of the oldest, at the end of the step.

    newest (2 q2,3,4): as `first_sizes`
    """
    count = len(newest)
    return JumpBank(
        sizes=np.concatenate([bank.sizes[count:], newest]),
        misfit=np.concatenate([bank.misfit[:, count:], np.zeros((3, count))], axis=1),
        log_weight=np.concatenate([bank.log_weight[count:], _expected_weights(bank.rate, count)]),
        newest_age=0.0,
        since_jump=bank.since_jump,
        rate=bank.rate,
    )


def signatures_at_sample(q: int) -> Array:
    """Return the signatures (q2,4 q2) in d, as of the sample that a step begins with, of jumps in the step.

    d is continuous from the right: a jump at the sample counts at the sample.
    """
    newest = np.zeros((q, q, _INSTANTS))
    newest[:, :, 0] = np.eye(q)
    return newest.reshape(q, -1)
