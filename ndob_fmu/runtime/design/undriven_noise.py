"""A small process noise for states that neither disturbance nor noise drives, as a current behind a known voltage.

Without any, their covariance decays to zero and no sample corrects them: where a parameter is wrong, so is the estimate
from then on. The noise assumes that such an equation is wrong by a small part of its terms, another error in each step.
It lets an output that shows the state correct it. Where none does, state and disturbance cannot be told apart: there
the noise is smaller, as it only widens the error bar.
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array

# Parts of an equation's terms. Larger ones cost accuracy where the model is right, smaller ones where it is wrong.
_SEEN, _UNSEEN = 0.02, 0.005


def undriven_noise(A: Array, C: Array, channels: Array, size: Array, by_input: Array, H: float) -> Array:
    """Return the intensities s (n,) of white noise on each ẋ_i, zero for states that `channels` (n,·) drive.

    Over a step it must act as noise spread over the step: e^{A H/2} diag(√(s H)) is a good factor of its covariance.
    With the noise at the start or the end of the step, other states are corrected wrongly for what it did meanwhile.
    The standard deviation of the noise over a step H (s) is a part of the root of the sum of squares of A_ij x_j, of
    the inputs' terms where a state has no others. It scales with the units of states and time.

    A (n,n), C (p,n): of the plant, linearised.
    channels (n,·): of disturbances and noises.
    size (n,): of the states.
    by_input (n,): size of the inputs' terms in ẋ.
    """
    driven = np.any(channels != 0.0, axis=1)
    for _ in range(len(A)):
        driven = driven | np.any((A != 0.0) & driven, axis=1)
    part = np.where(np.any(C != 0.0, axis=0), _SEEN, _UNSEEN)
    terms = np.linalg.norm(A * size, axis=1)
    terms = np.where(terms > 0.0, terms, by_input)
    return np.asarray(np.where(driven, 0.0, (part * terms) ** 2 * H))
