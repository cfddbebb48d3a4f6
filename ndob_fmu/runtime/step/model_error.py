"""How wrong the model's equations are: a part of their terms that counts as noise.

Where more is measured than there are disturbances, outputs contradict each other if an equation between them is wrong,
as a motor's angle and its current do where its flux is. A filter without noise on that equation gives the contradiction
to the states and to d, and the estimate runs away. So this noise begins where d̂ is far beyond its bound and more
innovations are large than disturbances could explain. Once that is over, it becomes smaller again.

One large innovation with one disturbance is no contradiction: its sensor, or the time of its sample, may be wrong. This
noise would only hide that from what finds the noise of the sensor.
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.prediction import Prediction

# The part of an equation's terms that is noise at first, at most, and below which there is none; its growth.
_FIRST, _MOST, _LEAST, _GROWTH = 0.02, 0.2, 0.002, 2.5
# No bound that was told is too small by more than this factor.
_BEYOND = 5.0
# The contradiction from which on a sample makes the part larger slowly, and that from which on fast.
_LARGE, _SLOWLY = 2.0, 1.1
_TOO_LARGE, _FAST = 9.0, 1.5
# Where the contradiction is below the first number, a sample takes this share of the part for each unit.
_USUAL, _TAKEN = 1.5, 0.3


def is_far_beyond_bound(model: FilterModel, xi: Array) -> bool:
    """Return whether d̂ of ξ̂ (N + past,) is farther from its nominal value than a bound that is somewhat too small."""
    off = xi[model.layout.disturbance] - np.array(model.settings.disturbance_nominal)
    return bool(np.any(np.abs(off) > _BEYOND * model.bound))


def followed(model: FilterModel, part: float, age: int, prediction: Prediction, *, beyond: bool) -> float:
    """Return the part of the terms that is noise after a sample.

    The contradiction is the largest e²/α of its outputs but for as many as there are disturbances.

    age: as in `FilterMemory`
    beyond: whether d̂ is far beyond its bound
    """
    innovation, std = prediction.innovation, prediction.std
    squares = sorted([(innovation[i] / std[i]) ** 2 for i, one in enumerate(prediction.measured) if one])
    place = len(squares) - model.layout.q - 1
    if place < 0:
        return part
    contradiction = squares[place]
    if beyond and contradiction > _TOO_LARGE and age > model.layout.size and np.any(model.doubtful):
        part = min(max(_GROWTH * part, _FIRST), _MOST)
    if contradiction > _LARGE:
        return min(part * (_FAST if contradiction > _TOO_LARGE else _SLOWLY), _MOST)
    part *= 1.0 - _TAKEN * max(_USUAL - contradiction, 0.0)
    return part if part > _LEAST else 0.0


def with_model_error(model: FilterModel, part: float, channel: Array, F: Array, xi: Array, H: float) -> Array:
    """Return the channel (N,·) of a step's noise with that of wrong equations.

    F (N,N): of `FilterModel.rates` over a step H (s) from ξ̂ (N or more,)
    """
    if part == 0.0:
        return channel
    n = model.layout.n
    size = np.maximum(np.abs(xi[:n]), model.start_std[:n])
    terms = np.sqrt(((F[:n, :n] * size) ** 2).sum(axis=1))
    wrong = np.zeros((model.layout.size, n))
    wrong[:n] = np.diag(part * np.sqrt(H) * terms)
    return np.concatenate([channel, wrong[:, model.doubtful]], axis=1)
