"""Jumps of the disturbance: a bank of hypotheses, one for each of the last samples (Willsky and Jones, 1976).

If d jumped by ν at a sample, the filter that does not know it is wrong by μ ν, with μ its signature, and its
innovations have the mean ρ ν. So the filter of a hypothesis is the one filter plus a correction of rank one,

    ν̂ = a/(b + 1/V),   ξ̂ + μ ν̂,   P + μ μᵀ/(b + 1/V),   a = Σ ρ e/α,   b = Σ ρ²/α,

with α the variance of an innovation and V the variance of a jump before it shows. Its weight over no jump is
p exp(½ a²/(b + 1/V))/√(1 + b V).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_state import JumpBank

# A jump is expected every three hundredth sample. It may be as large as from one bound to the other: V = 2 D₀².
_LOG_PROBABILITY = float(np.log(0.003))
_VARIANCE = 2.0
LENGTH = 12
# Hypotheses of less weight are not worth a correction; those of more replace the filter's state.
_MENTIONED, _CERTAIN = 0.3, 0.95
# Without evidence, a jump before more samples than these would have shown.
_UNSEEN = 3
# A jump inside a step lies anywhere in it: the standard deviation of a number between 0 and 1.
_WITHIN_STEP = 0.29


@dataclass(frozen=True)
class Mixture:
    """What the hypotheses add to the estimate.

    shift (rows,): mean of the correction of ξ̂.
    variance (rows,): its variance.
    certain: index of the hypothesis that is certain; −1 if none is.
    """

    shift: Array
    variance: Array
    certain: int


def empty_bank(rows: int, q: int) -> JumpBank:
    """Return a bank without hypotheses."""
    size = LENGTH * q
    return JumpBank(np.zeros((rows, size)), np.zeros(size), np.zeros(size), np.full(size, -np.inf), np.inf)


def full_bank(signatures: list[Array]) -> JumpBank:
    """Return a bank without evidence, from L signatures (rows,q2), the oldest first."""
    joined = np.hstack(signatures)
    size = joined.shape[1]
    weights = np.full(size, -np.inf)
    weights[-_UNSEEN * signatures[0].shape[1] :] = _LOG_PROBABILITY
    return JumpBank(joined, np.zeros(size), np.zeros(size), weights, 0.0)


def variances(disturbance_bound: Array) -> Array:
    """Return V (L q2,) of each hypothesis, for D₀ (q2,)."""
    return np.tile(_VARIANCE * disturbance_bound**2, LENGTH)


def gain(evidence: Array, precision: Array, V: Array) -> Array:
    """Return the logarithm of what the evidence adds to the weights (L q2,)."""
    return np.asarray(0.5 * evidence**2 / (precision + 1.0 / V) - 0.5 * np.log1p(precision * V))


def mixture(bank: JumpBank, V: Array) -> Mixture:
    """Return mean and variance of the correction by all hypotheses, no jump included."""
    log_weights = bank.log_weight + gain(bank.evidence, bank.precision, V)
    top = max(float(np.max(log_weights)), 0.0)
    weights = np.exp(log_weights - top)
    weights = weights / (np.exp(-top) + np.sum(weights))
    total = float(np.sum(weights))
    rows = len(bank.signatures)
    if total <= _MENTIONED:
        return Mixture(np.zeros(rows), np.zeros(rows), -1)
    variance = 1.0 / (bank.precision + 1.0 / V)
    size = bank.evidence * variance
    shift = bank.signatures @ (weights * size)
    square = bank.signatures**2 @ (weights * (variance + size**2))
    certain = int(np.argmax(weights)) if total > _CERTAIN else -1
    return Mixture(shift, np.maximum(square - shift**2, 0.0), certain)


def accept(bank: JumpBank, chosen: int, V: Array, newest: Array) -> tuple[Array, Array]:
    """Return what a certain hypothesis adds to ξ̂ (rows,), and the columns (rows,2) that it adds to the factor of P.

    newest (rows,q2): the signatures of jumps at the sample itself. The second column stands for the time of the jump,
    which lies anywhere between two samples.
    """
    q = newest.shape[1]
    following = np.hstack([bank.signatures, newest])[:, chosen + q]
    variance = 1.0 / (bank.precision[chosen] + 1.0 / V[chosen])
    signature, size = bank.signatures[:, chosen], bank.evidence[chosen] * variance
    columns = np.column_stack([signature * np.sqrt(variance), (signature - following) * abs(size) * _WITHIN_STEP])
    return signature * size, columns


def with_newest(bank: JumpBank, newest: Array, spacing: float) -> JumpBank:
    """Return the bank with the hypotheses of a jump at this sample in place of the oldest.

    Where the last ones are nearer than the spacing (s), a jump between cannot be told from them, and nothing is added.
    """
    if bank.newest_age < spacing * (1.0 - 1e-9):
        return bank
    q = newest.shape[1]
    return replace(
        bank,
        newest_age=0.0,
        signatures=np.hstack([bank.signatures[:, q:], newest]),
        evidence=np.concatenate([bank.evidence[q:], np.zeros(q)]),
        precision=np.concatenate([bank.precision[q:], np.zeros(q)]),
        log_weight=np.concatenate([bank.log_weight[q:], np.full(q, _LOG_PROBABILITY)]),
    )
