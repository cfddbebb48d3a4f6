"""How wrong the model's equations are: a part of their terms that counts as noise.

Where more is measured than there are disturbances, outputs contradict each other if an equation between them is wrong,
as a motor's angle and its current do where its flux is. A filter without noise on that equation gives the contradiction
to the states and to d, and the estimate runs away. So this noise begins where d̂ is far beyond its bound. Once
innovations are as large as their variances say, it becomes smaller again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import SensorMemory
from ndob_fmu.runtime.step.prediction import Prediction

# The part of an equation's terms that is noise at first, at most, and below which there is none; its growth.
_FIRST, _MOST, _LEAST, _GROWTH = 0.02, 0.5, 0.002, 2.5
# No bound that was told is too small by more than this factor.
_BEYOND = 5.0
# The mean square of an output's innovations, over their variances, from which on a sample makes the part larger slowly,
# and that from which on fast.
_LARGE, _SLOWLY = 2.0, 1.1
_TOO_LARGE, _FAST = 9.0, 1.5
# Where the mean square over all outputs is below the first number, a sample takes this share of the part for each unit.
_USUAL, _TAKEN = 1.5, 0.1


def raised(model: FilterModel, part: float, age: int, sensors: Sequence[SensorMemory]) -> float:
    """Return the part of the terms that is noise once d̂ is beyond its bound; `age`: as in `FilterMemory`.

    Where innovations are not large, d may be beyond it, and the equations right.
    """
    small = all(sensor.usual <= _TOO_LARGE for sensor in sensors)
    if small or age <= model.layout.size or not np.any(model.doubtful):
        return part
    return min(max(_GROWTH * part, _FIRST), _MOST)


def is_far_beyond_bound(model: FilterModel, xi: Array) -> bool:
    """Return whether d̂ of ξ̂ (N + past,) is farther from its nominal value than a bound that is somewhat too small."""
    off = xi[model.layout.disturbance] - np.array(model.settings.disturbance_nominal)
    return bool(np.any(np.abs(off) > _BEYOND * model.bound))


def followed(part: float, prediction: Prediction, sensors: Sequence[SensorMemory]) -> float:
    """Return the part of the terms that is noise after a sample."""
    usual = [sensor.usual for sensor in sensors]
    most, mean = max(usual), sum(usual) / len(usual)
    far = any(e * e > _TOO_LARGE * std * std for e, std in zip(prediction.innovation, prediction.std, strict=True))
    if most > _LARGE:
        return min(part * (_FAST if far and most > _TOO_LARGE else _SLOWLY), _MOST)
    part *= 1.0 - _TAKEN * max(_USUAL - mean, 0.0)
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
