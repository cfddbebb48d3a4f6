"""What in a log does not look like the model's signals, as a column in another unit, or tells less than it seems to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ndob_fmu.log.held_rows import HeldRows
from ndob_fmu.log.log import Found, Log
from ndob_fmu.log.online import Stretch, usual_step
from ndob_fmu.log.own_input import OwnInput
from ndob_fmu.log.smooth.along import unpacked_rows
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.pace import Pace, pace_of, pace_warnings
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.step.observer import Estimate
from ndob_fmu.runtime.step.sampled_observer import SampledObserver

# Values that are outside a range by more than its width, in more than this share of the rows, are another quantity.
_WIDTHS, _SHARE = 1.0, 0.01
# The first sample is so many standard deviations from what the start values predict.
_FAR_FROM_START = 10.0
# The estimate exceeds the bound by this factor.
_BEYOND_BOUND = 3.0
_LIKELY = "a wrong unit (--unit) or another column (--map)?"
_LIKELY_BEYOND = "the bound is too small, the model lacks something, or a column has a wrong unit (--unit)"


class Plausibility:
    """Counts over the rows of a log, block by block.

    bound (q2,): D₀; pace: of the plant, None where that is not known
    """

    def __init__(self, eq: Equations, observer: SampledObserver, bound: Sequence[float], pace: Pace | None) -> None:
        self._eq, self._bound, self._pace, self._step = eq, np.array(bound, dtype=float), pace, 0.0
        self._own_input, self._held = OwnInput(eq, observer.parameters), HeldRows(eq, observer.parameters)
        self._layout = observer.layout
        self._names = (*eq.inputs, *eq.outputs)
        count, everything = len(self._names), (-np.inf, np.inf)
        low, high = np.array([eq.ranges.get(name, everything) for name in self._names]).reshape(count, 2).T
        self._low, self._high = low, high
        self._seen, self._outside = np.zeros(count), np.zeros(count)
        self._least, self._most = np.full(count, np.inf), np.full(count, -np.inf)
        self._rows, self._beyond, self._largest = 0, np.zeros(len(bound)), np.zeros(len(bound))
        self._start: list[str] = []
        self._found = Found()

    def blocks(self, blocks: Iterator[Log]) -> Iterator[Log]:
        """Yield the blocks of a log, counted."""
        for block in blocks:
            if not self._step and len(block.time) > 1:
                self._step = usual_step(block.time)
            rows = np.concatenate([block.inputs, block.outputs], axis=1)
            with np.errstate(invalid="ignore"):  # a range without an end has no width
                width = _WIDTHS * (self._high - self._low)
                outside = (rows < self._low - width) | (rows > self._high + width)
            self._found += block.found
            self._outside += outside.sum(axis=0)
            self._seen += np.isfinite(rows).sum(axis=0)
            self._least = np.fmin(self._least, np.fmin.reduce(rows, axis=0))
            self._most = np.fmax(self._most, np.fmax.reduce(rows, axis=0))
            yield block

    def start(self, sample: Array, before: Estimate) -> None:
        """Compare the first sample (p,) with what the start values predict."""
        for name, y, off, size in zip(
            self._eq.outputs, sample.tolist(), before.residual, before.residual_std, strict=True
        ):
            if np.isfinite(y) and abs(off) > _FAR_FROM_START * size > 0.0:
                unit = self._unit(name)
                self._start.append(
                    f"{name} is {y:.4g}{unit} in the first row, where the start values say {y - off:.4g} ± "
                    f"{2.0 * size:.2g}{unit}: {_LIKELY}"
                )

    def add(self, stretch: Stretch) -> None:
        """Count an estimate."""
        x = unpacked_rows(self._layout, stretch.online.predicted)[:, : self._layout.n]
        self._own_input.add(stretch, x)
        self._held.add(stretch, x)
        off = np.abs(stretch.online.d_at_sample - self._eq.disturbance_nominal)
        self._rows += len(off)
        self._beyond += (off > _BEYOND_BOUND * self._bound).sum(axis=0)
        self._largest = np.fmax(self._largest, off.max(axis=0))

    def warnings(self) -> list[str]:
        """Return what does not look like the model's signals, one line each."""
        found = self._found.warnings
        for i, name in enumerate(self._names):
            if not self._seen[i]:
                if name in self._eq.outputs:
                    found.append(f"{name} was never measured: what only this output shows is not estimated")
                continue
            share = self._outside[i] / self._seen[i]
            if share > _SHARE:
                found.append(
                    f"{name} goes from {self._least[i]:.4g} to {self._most[i]:.4g}{self._unit(name)}, far outside its "
                    f"range, {self._low[i]:g} to {self._high[i]:g}, in {100.0 * share:.0f} % of the rows: {_LIKELY}"
                )
        found += [*self._own_input.warnings(), *self._held.warnings()]
        found += self._start
        for i, name in enumerate(self._eq.disturbances):
            if self._beyond[i] > _SHARE * max(self._rows, 1):
                times = self._largest[i] / self._bound[i]
                found.append(f"the estimate of {name} reaches {times:.2g} × disturbance_bound: {_LIKELY_BEYOND}")
        if self._pace is not None and self._step:
            found += pace_warnings(self._pace, self._eq.disturbances, self._step)
        return found

    def _unit(self, name: str) -> str:
        unit = self._eq.units.get(name, "")
        return f" {unit}" if unit else ""


def plausibility(eq: Equations, observer: SampledObserver, bound: Sequence[float], x_hat: Vector) -> Plausibility:
    """Return what counts over a log for a plant with an observer from x̂₀ (n,).

    bound (q2,): D₀, which for a plant with a channel is not that of the observer's disturbances
    """
    if eq.channel is not None:
        return Plausibility(eq, observer, bound, None)
    told = observer.settings
    pace = pace_of(
        eq, observer.parameters, x_hat, bound=told.disturbance_bound, rate=told.disturbance_rate, order=told.order
    )
    return Plausibility(eq, observer, bound, pace)


def with_likely_cause(message: str, warnings: Sequence[str]) -> str:
    """Return the message of an error with what does not look like the model's signals."""
    return f"{message}; likely cause: {warnings[0]}" if warnings else message
