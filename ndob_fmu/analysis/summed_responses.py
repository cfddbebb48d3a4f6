"""Sums of the magnitudes of impulse responses over all steps, Σ_j |c Fʲ b|.

Most responses end after some hundred steps. One that decays slowly is summed in closed form from the step on at which
its sign no longer changes: Σ_j c Fʲ b = c (I − F)⁻¹ b. That is so where its slowest mode decays without oscillation
and is larger than all others together.

Slow oscillations are summed over every s-th step, times s, once the faster modes have died out: a rectangle rule, less
half of what its first term has too much. Its error stays below (s |ln λ|)²/8 of the sum of all modes' magnitudes, where
λ is the fastest mode left; that is added. So is the sum of the modes' magnitudes from the last step on. So the result
is a bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array

Added = Callable[[Array], Array]

_TAIL = 1e-7
_MOST_STEPS = 1_000_000
_STEPS_AT_ONCE = 16
# Before the first look at the modes; each next one comes after as many steps again.
_FIRST_LOOK = 512
# Modes that add less than this part to a sum do not count.
_NEGLIGIBLE = 1e-12
# The same for the modes that a stride of several steps must resolve, over the stride.
_DIED_OUT = 1e-6
# By how much a mode may turn or decay within a stride.
_RESOLVED = 0.1
# Of a sum: the most that a bound of an error may add to it.
_MARGIN = 2e-3
# The slowest mode over all others together, so that errors of the modes change no sign.
_DOMINANT = 2.0
_SAME = 1e-3  # of the slowest mode: how well the modes must add up to the response


def summed(added: Added, on_state: Array, step: Array, inputs: Array, *, by_element: bool) -> Array:
    """Return a bound of Σ_j added(on_state stepʲ inputs), hardly above it.

    added: takes the responses (R,·) of some steps side by side and returns one term for each step, (R,steps,·).
    on_state (R,N), step (N,N), inputs (N,·): of the responses.
    by_element: whether `added` is linear in the magnitudes of the single responses.
    """

    def at_the_join(before: int, after: int, on_state: Array) -> Array:
        """Return what the rectangle rule lacks at the end of one stride, less its excess at the next one's start."""
        return np.asarray(0.5 * (before - after) * added(on_state @ inputs)[:, 0])

    modes = _modes(step, inputs)
    stride, look, done, judge = 1, _FIRST_LOOK, 0, 0
    together, ahead = _side_by_side(step, inputs, stride)
    total = np.zeros_like(added(on_state @ inputs)[:, 0])
    left = np.arange(len(on_state))
    while done < _MOST_STEPS:
        if done == look:
            look *= 2
            if by_element and modes is not None:
                one_sign = _keep_their_signs(added, modes, on_state, inputs, total[left])
                if np.any(one_sign):
                    ending, on_state = on_state[one_sign], on_state[~one_sign]
                    tails = ending @ np.linalg.solve(np.eye(len(step)) - step, inputs)
                    total[left[one_sign]] += added(np.abs(tails))[:, 0] + at_the_join(stride, 1, ending)
                    left = left[~one_sign]
            if not len(left):
                return total
            coarser, error = _coarser(added, modes, on_state, total[left], stride, done)
            if coarser > stride:
                total[left] += error + at_the_join(stride, coarser, on_state)
                stride = coarser
                together, ahead = _side_by_side(step, inputs, stride)
        terms = added(on_state @ together)
        total[left] += stride * np.sum(terms, axis=1)
        on_state, done = on_state @ ahead, done + _STEPS_AT_ONCE * stride
        if done >= judge and np.all(terms[:, -1] <= _TAIL * total[left]):
            rest, judge = _rest(added, modes, on_state, total[left]), 2 * done
            if np.all(rest <= _MARGIN * total[left]):
                break
    total[left] += _rest(added, modes, on_state, total[left]) + at_the_join(stride, 1, on_state)
    return total


def _rest(added: Added, modes: _Modes | None, on_state: Array, total: Array) -> Array:
    """Return a bound (R,·) of what all further steps add, from the modes; 0 where these are not told apart."""
    return np.zeros_like(total) if modes is None else sum(modes.sums(added, on_state), np.zeros_like(total))


def _side_by_side(step: Array, inputs: Array, stride: int) -> tuple[Array, Array]:
    """Return step^{stride i} inputs for i = 0 … 15 side by side, and step^{16 stride}."""
    once = np.linalg.matrix_power(step, stride)
    later = [inputs]
    for _ in range(_STEPS_AT_ONCE - 1):
        later.append(once @ later[-1])
    return np.hstack(later), np.linalg.matrix_power(once, _STEPS_AT_ONCE)


@dataclass(frozen=True)
class _Modes:
    """The modes of the responses: c Fʲ b = Σ_i (c vectors)_i valuesᵢʲ of_inputs_i.

    values (N,), vectors (N,N), of_inputs (N,·): complex; all |values| < 1
    """

    values: NDArray[np.complex128]
    vectors: NDArray[np.complex128]
    of_inputs: NDArray[np.complex128]

    def sizes(self, on_state: Array, i: int) -> Array:
        """Return the magnitude (R,·) of a mode in each response."""
        return np.asarray(np.abs((on_state @ self.vectors[:, i])[:, None] * self.of_inputs[i]))

    def sums(self, added: Added, on_state: Array) -> list[Array]:
        """Return for each mode what the sum over all its magnitudes adds (R,·)."""
        return [
            added(self.sizes(on_state, i) / (1.0 - abs(value)))[:, 0] for i, value in enumerate(self.values.tolist())
        ]


def _modes(step: Array, inputs: Array) -> _Modes | None:
    """Return the modes; None where they are not told apart or do not decay."""
    values, vectors = np.linalg.eig(step)
    try:
        of_inputs = np.linalg.solve(vectors, inputs.astype(complex))
    except np.linalg.LinAlgError:
        return None
    if not (np.all(np.isfinite(of_inputs)) and np.all(np.abs(values) < 1.0)):
        return None
    return _Modes(values.astype(complex), vectors.astype(complex), of_inputs)


def _coarser(
    added: Added, modes: _Modes | None, on_state: Array, total: Array, stride: int, done: int
) -> tuple[int, Array]:
    """Return a larger stride that resolves all modes which have not died out, and the bound (R,·) of its error.

    The stride stays where there is none. total (R,·): what a row's sum is already.
    """
    nothing = np.zeros_like(total)
    if modes is None:
        return stride, nothing
    sums = modes.sums(added, on_state)
    with np.errstate(divide="ignore"):
        rates = np.abs(np.log(modes.values))

    def fastest(stride: int) -> float:
        return max(
            (rate for rate, one in zip(rates, sums, strict=True) if np.any(one * stride > _DIED_OUT * total)),
            default=0.0,
        )

    coarser, error, rest = stride, nothing, sum(sums, nothing)
    while 2 * coarser * _STEPS_AT_ONCE <= done:
        turn = 2 * coarser * fastest(2 * coarser)
        if turn > _RESOLVED or np.any(rest * turn**2 / 8.0 > _MARGIN * total):
            break
        coarser, error = 2 * coarser, rest * turn**2 / 8.0
    return coarser, error


def _keep_their_signs(added: Added, modes: _Modes, on_state: Array, inputs: Array, total: Array) -> NDArray[np.bool_]:
    """Return which rows (R,) have responses on_state stepʲ inputs whose signs are the same for all j ≥ 0.

    total (R,·): what a row's sum is already, against which modes may be negligible.
    """
    slowness = np.abs(modes.values)
    over_channels = tuple(range(1, total.ndim))
    slowest, others = np.zeros((len(on_state), inputs.shape[1])), np.zeros((len(on_state), inputs.shape[1]))
    found = np.zeros(len(on_state), dtype=bool)
    monotone = ~found
    sums = modes.sums(added, on_state)
    for i in np.argsort(-slowness, kind="stable"):
        sizes = modes.sizes(on_state, int(i))
        counts = np.any(sums[i] > _NEGLIGIBLE * total, axis=over_channels)
        first = counts & ~found
        slowest[first], found = sizes[first], found | counts
        monotone[first] = modes.values[i].imag == 0.0 and modes.values[i].real > 0.0
        others[counts & ~first] += sizes[counts & ~first]
    off = np.abs(((on_state @ modes.vectors) @ modes.of_inputs).real - on_state @ inputs)
    certain = np.all((slowest >= _DOMINANT * others) & (off <= _SAME * slowest), axis=1)
    return np.asarray(monotone & (certain | ~found))
