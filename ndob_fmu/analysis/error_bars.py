"""The error bars that an observer will show, from a run on samples as it expects them."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.design.operating_point import middle_input
from ndob_fmu.runtime.design.stationary_design import StationaryDesign
from ndob_fmu.runtime.step.converged_step import disturbance_std
from ndob_fmu.runtime.step.sampled_observer import SampledObserver, without_adaptation

_MOST_STEPS = 1000
_START = 4  # samples for each entry of the observer's state, before which its error bars are not judged
_WINDOW = 20  # steps in which a settled error bar changes by less than the part below
_SETTLED = 1e-3


def stationary_at(observer: SampledObserver, H: float) -> tuple[StationaryDesign, bool]:
    """Return the design of the frozen gain at a step H (s), and True; without one, that with the slopes of f known.

    All predictions of the observer's errors come from it. Raises DesignError where there is neither.
    """
    try:
        return observer.design(H), True
    except DesignError:
        return observer.tracking.at(H).stationary, False


def settled_error_bars(observer: SampledObserver, x_hat: Array, H: float) -> tuple[Array, Array]:
    """Return the error bars (q2,) of d̂ a step ahead and of the lagged d̂ once they have settled, at steps of H (s).

    Where the gain freezes they are known from its design. Elsewhere they come from a run, in which the plant moves as
    the observer predicts it from x̂₀ (n,), with inputs in the middle of their ranges, or 0. Each sample is off by half
    its noise, with alternating signs: equal samples would pass for those of a stuck sensor. The noise does not adapt to
    that. After 1000 steps the error bars are taken as they are.
    """
    if observer.tuned(H).freezes:
        return disturbance_std(observer.designs.at(H, H))
    observer = without_adaptation(observer)
    u = middle_input(observer.equations.inputs, observer.equations.ranges)
    nothing = (0.0,) * len(observer.equations.outputs)
    state = observer.init(x_hat.tolist())
    shown: list[Array] = []
    for k in range(_MOST_STEPS):
        expected = -np.array(observer.estimate(state, nothing).residual)
        y = expected + (0.5 if k % 2 else -0.5) * observer.noise_std
        state, estimate = observer.step(state, u, y.tolist(), H)
        shown.append(np.array([estimate.d_std, estimate.d_lagged_std]))
        change = np.ptp(shown[-_WINDOW:], axis=0)
        started = k >= _START * observer.layout.size + _WINDOW and k * H > 2.0 * observer.settings.lag
        if started and np.all(change <= _SETTLED * shown[-1]):
            break
    return shown[-1][0], shown[-1][1]
