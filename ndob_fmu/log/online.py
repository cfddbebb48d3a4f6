"""The observer along a log, as it would have run online: one step for each row."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.errors import UsageError
from ndob_fmu.log.log import Log
from ndob_fmu.results.shown_time import seconds
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.step.channel_observer import ChannelState
from ndob_fmu.runtime.step.filter_state import SampledObserverState
from ndob_fmu.runtime.step.observer import Estimate, Observer

# Where nothing is measured for longer, the observer steps as often; a longer step would make it tune itself anew.
_LONGEST = 2.0
_MOST_PARTS = 1_000_000

# Rows after which a ratio of the noise, which follows the residuals, can be believed.
SURE_OF_NOISE = 200


@dataclass(frozen=True)
class Online:
    """What the observer said in the step from each row of a log.

    predicted: ξ̂⁻ before the sample, as in `SampledObserverState`
    x_hat (K,n), d_hat (K,q2), d_std (K,q2): for the end of the step
    d_at_sample (K,q2): for the sample; d_lagged, d_lagged_std (K,q2): a lag before it
    residual, residual_std (K,p): of the sample; NaN where nothing was measured
    noise_ratio (K,p): of the variance that the sample counts with over the one that was told
    refused (K,p): 1 where the sample was refused
    valid, consistency (K,): as in `Estimate`
    """

    predicted: Array
    x_hat: Array
    d_hat: Array
    d_at_sample: Array
    d_std: Array
    d_lagged: Array
    d_lagged_std: Array
    residual: Array
    residual_std: Array
    noise_ratio: Array
    refused: Array
    valid: Array
    consistency: Array


@dataclass(frozen=True)
class Stretch:
    """A block of a log, and what the observer said there.

    usual: the step (s) that the observer is tuned for
    step (K,): from each row to the next (s)
    """

    usual: float
    log: Log
    step: Array
    online: Online

    def rows(self, which: slice) -> Stretch:
        """Return some of its rows."""
        return _each(self, lambda column: column[which])

    def and_then(self, following: Stretch) -> Stretch:
        """Return both as one."""
        others = iter((*_columns(following.log), following.step, *_columns(following.online)))
        return _each(self, lambda column: np.concatenate([column, next(others)]))


def _columns(value: Log | Online) -> list[Array]:
    return [getattr(value, one.name) for one in fields(value) if one.name != "found"]


def _each(stretch: Stretch, change: Callable[[Array], Array]) -> Stretch:
    """Return a stretch with all its columns changed, in their order."""
    time, inputs, outputs = map(change, _columns(stretch.log))
    log = Log(time, inputs, outputs, stretch.log.found)
    return Stretch(stretch.usual, log, change(stretch.step), Online(*map(change, _columns(stretch.online))))


# run(block, step, usual): what an observer says along the next rows, of steps (K,) s, where the usual one has `usual` s
Run = Callable[[Log, Array, float], Online]


def along(observer: Observer[Any], x_hat: Vector, blocks: Iterator[Log], run: Run | None = None) -> Iterator[Stretch]:
    """Yield the stretches of a log, from x̂₀ (n,). The last row has the usual step.

    run: what takes the observer's steps; none: Python

    Raises UsageError for a gap that cannot be bridged, IntegrationError where the estimate leaves the finite numbers,
    DesignError where the observer has no tuning for the usual step of the first block.
    """
    run = run or _InPython(observer, x_hat)
    block = next(blocks)
    following = next(blocks, None)
    usual = usual_step(block.time if following is None else np.append(block.time, following.time[0]))
    while True:
        end = block.time[-1] + usual if following is None else following.time[0]
        step = np.diff(block.time, append=end)
        yield Stretch(usual, block, step, run(block, step, usual))
        if following is None:
            return
        block, following = following, next(blocks, None)


def usual_step(time: Array) -> float:
    """Return the usual step (s) between two or more times."""
    # The last digits of times are rounding errors; with them a log's estimate would depend on its first row.
    return float(f"{np.median(np.diff(time)):.9g}")


def parts_of_steps(log: Log, step: Array, usual: float) -> NDArray[np.int_]:
    """Return in how many parts (K,) the steps from the rows of a log are taken, which over a gap are several.

    Only the first part has a sample. Raises UsageError for a gap that cannot be bridged.
    """
    parts = np.ceil(step / (_LONGEST * usual))
    if parts.max() > _MOST_PARTS:
        k = int(np.argmax(parts > _MOST_PARTS))
        raise UsageError.report(
            f"log at {seconds(log.time[k])} s",
            expected=f"gaps of at most {_MOST_PARTS} usual steps",
            received=f"{step[k]:.3g} s without a row",
            likely="two records in one file, or times in another unit (--unit)",
        )
    return np.asarray(parts.astype(np.int_))


def sampled(state: Any) -> SampledObserverState:
    """Return the state of the sampled-data observer in that of any observer of a log."""
    found: SampledObserverState = state.lumped if isinstance(state, ChannelState) else state
    return found


class _InPython:
    """The observer's steps, taken one after the other in Python."""

    def __init__(self, observer: Observer[Any], x_hat: Vector) -> None:
        self._observer, self._state, self._is_tuned = observer, observer.init(x_hat), False

    def __call__(self, log: Log, step: Array, usual: float) -> Online:
        """Return what the observer says along the next rows."""
        if not self._is_tuned:
            self._state, self._is_tuned = _tuned_for(self._state, usual), True
        rows, none = [], (np.nan,) * log.outputs.shape[1]
        each = (log.inputs.tolist(), log.outputs.tolist(), step.tolist(), parts_of_steps(log, step, usual).tolist())
        for u, y, H, parts in zip(*each, strict=True):
            before = self._state
            self._state, estimate = self._observer.step(before, tuple(u), tuple(y), H / parts)
            for _ in range(parts - 1):
                self._state, _ = self._observer.step(self._state, tuple(u), none, H / parts)
            rows.append(_row(sampled(before), sampled(self._state), estimate))
        said = Online(*(np.array(column, dtype=float) for column in zip(*rows, strict=True)))
        said.residual[np.isnan(log.outputs)] = np.nan
        return said


def _tuned_for(state: Any, usual: float) -> Any:
    """Return the first state of an observer that is tuned for the usual step, not for the first one."""
    first = sampled(state)
    first = replace(first, memory=replace(first.memory, tuned_at=usual))
    return replace(state, lumped=first) if isinstance(state, ChannelState) else first


def _row(
    before: SampledObserverState, after: SampledObserverState, estimate: Estimate
) -> tuple[Sequence[float] | float, ...]:
    """Return the fields of `Online` at one row."""
    return (
        before.xi_hat,
        estimate.x_hat,
        estimate.d_hat,
        estimate.d_at_sample,
        estimate.d_std,
        estimate.d_lagged,
        estimate.d_lagged_std,
        estimate.residual,
        estimate.residual_std,
        [sensor.noise_ratio for sensor in before.memory.sensors],
        [float(sensor.refused) for sensor in after.memory.sensors],
        float(estimate.valid),
        estimate.consistency,
    )
