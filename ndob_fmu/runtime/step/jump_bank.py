"""Jumps of the disturbance: a bank of hypotheses, two for each of the last steps (Willsky and Jones, 1976).

A jump of d adds μ ν to the error of ξ̂, with μ the response to a jump of one. The first hypothesis is a jump at the
sample. The second is one inside the step; it stands as jumps at the three nodes of Gauss and Legendre, of independent
sizes with the variances w_i V, which gives the covariance of a jump at any instant. The filter that does not know it
has innovations of the mean ρᵀν, and that of the hypothesis is the one filter plus a correction,

    ν̂ = (B + W)⁻¹ a,   ξ̂ + M ν̂,   P + M (B + W)⁻¹ Mᵀ,   a = Σ ρ e/α,   B = Σ ρ ρᵀ/α,   W = diag(1/(w_i V)),

with α the variance of an innovation. The weight over no jump is p L(E − aᵀν̂)/L(E)/√det(I + W⁻¹ B), E = Σ e²/α. L is
Student's density, because α is not sure: innovations that are all too large speak for a larger noise, not for a jump.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_state import JumpBank

# A jump is expected every three hundredth sample. It may be as large as from one bound to the other: V = 2 D₀².
_LOG_PROBABILITIES = np.log(0.003 * np.array([0.7, 0.3]))  # at the sample, within the step
_VARIANCE = 2.0
LENGTH = 12
# The instants of a jump, in parts of the step, and their weights.
INSTANTS = (0.0, 0.5 - 0.15**0.5, 0.5, 0.5 + 0.15**0.5)
_NODES = 3
_NONE = 1e-200  # stands for the weight of a node that a hypothesis does not have
_WEIGHTS = np.array([[1.0, _NONE, _NONE], [5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0]])
_KINDS = len(_WEIGHTS)
# Hypotheses of less weight are not worth a correction; those of more replace the filter's state.
_MENTIONED, _CERTAIN = 0.4, 0.95
_SOME = 4.0  # a smaller aᵀν̂ leaves every weight below that
# The variances of the innovations are as sure as if so many innovations had told them.
_SURE = 20.0
# Without evidence, a jump before more samples than these would have shown.
_UNSEEN = 3
# A second jump within so many samples means that the derivatives of d have changed too.
LONG_AGO = 24


@dataclass(frozen=True)
class Mixture:
    """What the hypotheses add to the estimate.

    shift (rows,): mean of the correction of ξ̂.
    variance (rows,): its variance.
    certain: whether there was a jump.
    """

    shift: Array
    variance: Array
    certain: bool


def empty_bank(rows: int, q: int) -> JumpBank:
    """Return a bank without hypotheses."""
    size = LENGTH * q * _KINDS
    return JumpBank(
        signatures=np.zeros((rows, size * _NODES)),
        evidence=np.zeros((size, _NODES)),
        precision=np.zeros((size, _NODES, _NODES)),
        misfit=np.zeros((size, 2)),
        log_weight=np.full(size, -np.inf),
        newest_age=np.inf,
        since_jump=LONG_AGO,
    )


def full_bank(signatures: list[Array]) -> JumpBank:
    """Return a bank without evidence, from L signatures (rows,4 q2) of jumps at the instants, the oldest first."""
    joined = np.hstack([_hypotheses(each) for each in signatures])
    bank = empty_bank(len(joined), joined.shape[1] // (LENGTH * _NODES * _KINDS))
    weights = np.tile(_LOG_PROBABILITIES, len(bank.log_weight) // _KINDS)
    weights[: -_UNSEEN * len(weights) // LENGTH] = -np.inf
    return replace(bank, signatures=joined, log_weight=weights, newest_age=0.0)


def inverse_variances(disturbance_bound: Array) -> Array:
    """Return W (2 L q2,3) of each hypothesis, for D₀ (q2,)."""
    V = np.tile(_VARIANCE * disturbance_bound**2, LENGTH)
    return np.asarray(1.0 / (V[:, None, None] * _WEIGHTS).reshape(-1, _NODES))


def gain(evidence: Array, precision: Array, misfit: Array, W: Array) -> Array:
    """Return the logarithm of what the evidence adds to the weights (2 L q2,)."""
    _, size, log_determinant = _solved(evidence, precision, W)
    explained = np.column_stack([np.sum(evidence * size, axis=1), np.zeros(len(size))])
    return np.asarray(
        likelihood(misfit - explained) - likelihood(misfit) - 0.5 * (log_determinant - np.sum(np.log(W), axis=1))
    )


def likelihood(misfit: Array) -> Array:
    """Return the logarithm of Student's density (2 L q2,) of innovations, over that of innovations of zero.

    misfit (2 L q2,2): their sum of squares over the variances, and their number
    """
    squares = np.maximum(misfit[:, 0], 0.0)
    return np.asarray(-0.5 * (_SURE + misfit[:, 1]) * np.log1p(squares / _SURE))


def mixture(bank: JumpBank, W: Array) -> Mixture:
    """Return mean and variance of the correction by all hypotheses, no jump included."""
    rows = len(bank.signatures)
    nothing = Mixture(np.zeros(rows), np.zeros(rows), certain=False)
    diagonal = np.diagonal(bank.precision, axis1=1, axis2=2) + W
    if float(np.max(np.sum(bank.evidence**2 / diagonal, axis=1))) < _SOME:
        return nothing
    log_weights = bank.log_weight + gain(bank.evidence, bank.precision, bank.misfit, W)
    top = max(float(np.max(log_weights)), 0.0)
    weights = np.exp(log_weights - top)
    weights = weights / (np.exp(-top) + np.sum(weights))
    total = float(np.sum(weights))
    if total <= _MENTIONED:
        return nothing
    factor, size, _ = _solved(bank.evidence, bank.precision, W)
    signatures = bank.signatures.reshape(rows, -1, _NODES)
    each = np.einsum("rhk,hk->rh", signatures, size)
    spread = np.sum(np.einsum("rhk,hjk->rhj", signatures, np.linalg.inv(factor)) ** 2, axis=2)
    shift = each @ weights
    best = int(np.argmax(weights))
    # The first sample after a jump cannot tell its size from its instant.
    settled = best < len(weights) - len(weights) // LENGTH
    variance = np.maximum((spread + each**2) @ weights - shift**2, 0.0)
    return Mixture(shift, variance, certain=total > _CERTAIN and settled)


def accepted(bank: JumpBank, W: Array) -> tuple[Array, Array]:
    """Return what a jump that is certain adds to ξ̂ (rows,), and the columns (rows,·) that it adds to the factor of P.

    Mean and covariance are those of all hypotheses together, that of no jump included, because no instant is certain.
    """
    rows = len(bank.signatures)
    log_weights = bank.log_weight + gain(bank.evidence, bank.precision, bank.misfit, W)
    top = float(np.max(log_weights))
    weights = np.exp(log_weights - top)
    none = float(np.exp(-top))
    weights, none = weights / (none + np.sum(weights)), none / (none + np.sum(weights))
    factor, size, _ = _solved(bank.evidence, bank.precision, W)
    signatures = bank.signatures.reshape(rows, -1, _NODES)
    each = np.einsum("rhk,hk->rh", signatures, size)
    shift = each @ weights
    roots = np.sqrt(weights)
    within = np.einsum("rhk,hjk->rhj", signatures, np.linalg.inv(factor)) * roots[:, None]
    between = np.column_stack([(each - shift[:, None]) * roots, -shift * np.sqrt(none)])
    return shift, np.hstack([within.reshape(rows, -1), between])


def with_newest(bank: JumpBank, newest: Array, spacing: float) -> JumpBank:
    """Return the bank with the hypotheses of a jump in this step in place of the oldest, at the end of the step.

    newest (rows,4 q2): the responses to jumps of each disturbance at the instants
    spacing: where the last ones are nearer than this (s), a jump between cannot be told from them
    """
    if bank.newest_age < spacing * (1.0 - 1e-9):
        return bank
    added = _hypotheses(newest)
    count = added.shape[1] // _NODES
    return JumpBank(
        signatures=np.hstack([bank.signatures[:, added.shape[1] :], added]),
        evidence=np.concatenate([bank.evidence[count:], np.zeros((count, _NODES))]),
        precision=np.concatenate([bank.precision[count:], np.zeros((count, _NODES, _NODES))]),
        misfit=np.concatenate([bank.misfit[count:], np.zeros((count, 2))]),
        log_weight=np.append(bank.log_weight[count:], np.tile(_LOG_PROBABILITIES, count // _KINDS)),
        newest_age=0.0,
        since_jump=bank.since_jump,
    )


def _hypotheses(newest: Array) -> Array:
    """Return the signatures (rows,6 q2) of both kinds of hypotheses, from responses (rows,4 q2) to jumps."""
    rows = len(newest)
    each = newest.reshape(rows, -1, len(INSTANTS))
    both = np.zeros((rows, each.shape[1], _KINDS, _NODES))
    both[:, :, 0, 0] = each[:, :, 0]
    both[:, :, 1] = each[:, :, 1:]
    return both.reshape(rows, -1)


def _solved(evidence: Array, precision: Array, W: Array) -> tuple[Array, Array, Array]:
    """Return the Cholesky factors of B + W (h,3,3), ν̂ (h,3) and log det (B + W) (h,)."""
    total = precision.copy()
    for i in range(_NODES):
        total[:, i, i] += W[:, i]
    factor = np.linalg.cholesky(total)
    size = np.linalg.solve(total, evidence[:, :, None])[:, :, 0]
    log_determinant = 2.0 * np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
    return factor, size, log_determinant
