"""Sums of the magnitudes of impulse responses over all steps, Σ_j |c Fʲ b|.

Most responses end after some hundred steps. One that decays slowly is summed in closed form from the step on at which
its sign no longer changes: Σ_j c Fʲ b = c (I − F)⁻¹ b. That is so where its slowest mode decays without oscillation
and is larger than all others together.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array

_TAIL = 1e-7
_MOST_STEPS = 1_000_000
_STEPS_AT_ONCE = 16
# Before the first look at the signs; each next one comes after as many steps again.
_FIRST_LOOK = 512
# Modes that add less than this part to a sum do not count.
_NEGLIGIBLE = 1e-12
# The slowest mode over all others together, so that errors of the modes change no sign.
_DOMINANT = 2.0
_SAME = 1e-3  # of the slowest mode: how well the modes must add up to the response


def summed(added: Callable[[Array], Array], on_state: Array, step: Array, inputs: Array, *, by_element: bool) -> Array:
    """Return Σ_j added(on_state stepʲ inputs), until a step adds next to nothing to any row's sum.

    added: takes the responses (R,·) of some steps side by side and returns one term for each step, (R,steps,·).
    on_state (R,N), step (N,N), inputs (N,·): of the responses.
    by_element: whether `added` is linear in the magnitudes of the single responses.
    """
    later = [inputs]
    for _ in range(_STEPS_AT_ONCE - 1):
        later.append(step @ later[-1])
    together, ahead = np.hstack(later), np.linalg.matrix_power(step, _STEPS_AT_ONCE)
    total = np.zeros_like(added(on_state @ inputs)[:, 0])
    left, look = np.arange(len(on_state)), _FIRST_LOOK
    for done in range(0, _MOST_STEPS, _STEPS_AT_ONCE):
        if by_element and done == look:
            one_sign = _keep_their_signs(added, on_state, step, inputs, total[left])
            if np.any(one_sign):
                tails = on_state[one_sign] @ np.linalg.solve(np.eye(len(step)) - step, inputs)
                total[left[one_sign]] += added(np.abs(tails))[:, 0]
            on_state, left, look = on_state[~one_sign], left[~one_sign], 2 * look
            if not len(left):
                break
        terms = added(on_state @ together)
        total[left] += np.sum(terms, axis=1)
        if np.all(terms[:, -1] <= _TAIL * total[left]):
            break
        on_state = on_state @ ahead
    return total


def _keep_their_signs(
    added: Callable[[Array], Array], on_state: Array, step: Array, inputs: Array, total: Array
) -> NDArray[np.bool_]:
    """Return which rows (R,) have responses on_state stepʲ inputs whose signs are the same for all j ≥ 0.

    total (R,·): what a row's sum is already, against which modes may be negligible.
    """
    none = np.zeros(len(on_state), dtype=bool)
    values, vectors = np.linalg.eig(step)
    slowness = np.abs(values)
    try:
        of_inputs = np.linalg.solve(vectors, inputs.astype(complex))
    except np.linalg.LinAlgError:
        return none
    if not (np.all(np.isfinite(of_inputs)) and np.all(slowness < 1.0)):
        return none
    of_state = on_state @ vectors
    over_channels = tuple(range(1, total.ndim))
    slowest, others = np.zeros((len(on_state), inputs.shape[1])), np.zeros((len(on_state), inputs.shape[1]))
    found, monotone = none.copy(), ~none
    for i in np.argsort(-slowness, kind="stable"):
        sizes = np.abs(of_state[:, i, None] * of_inputs[i])
        adds = added(sizes / (1.0 - slowness[i]))[:, 0]
        counts = np.any(adds > _NEGLIGIBLE * total, axis=over_channels)
        first = counts & ~found
        slowest[first], found = sizes[first], found | counts
        monotone[first] = values[i].imag == 0.0 and values[i].real > 0.0
        others[counts & ~first] += sizes[counts & ~first]
    off = np.abs((of_state @ of_inputs).real - on_state @ inputs)
    certain = np.all((slowest >= _DOMINANT * others) & (off <= _SAME * slowest), axis=1)
    return np.asarray(monotone & (certain | ~found))
