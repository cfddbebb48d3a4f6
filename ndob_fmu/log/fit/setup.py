"""From start values and a log to what a class of disturbances is fitted to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ndob_fmu.codegen.row_functions import row_functions
from ndob_fmu.errors import UsageError, nearest, one_of
from ndob_fmu.interface.model_variables import OWN_ORDER, for_each_disturbance
from ndob_fmu.interface.told_observer import for_disturbances, told_observer
from ndob_fmu.log.first_block import ObserverRun, first_block, run_along
from ndob_fmu.log.fit.offsets import check_offsets, offset_names, open_offsets
from ndob_fmu.log.fit.problem import PIECE, Problem
from ndob_fmu.log.fit.tried_rates import MOST_ROWS, TRIED
from ndob_fmu.log.fit.while_moving import while_moving
from ndob_fmu.log.log import Log
from ndob_fmu.log.online import Online, Stretch
from ndob_fmu.log.smooth.along import Samples, in_layout, unpacked_rows
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.smoothable import check_smoothed
from ndob_fmu.log.told_values import ignored
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.step.layout import Layout
from ndob_fmu.runtime.step.sampled_observer import SampledObserver
from ndob_fmu.runtime.step.tuned import Tuned
from ndob_fmu.support.progress import begin

# Rows that the fit needs, and rows within which there is one new event.
_LEAST_ROWS = 500
_SPACING = 3
# Prior standard deviation of a parameter that has none, over its size.
_OPEN = 0.5


@dataclass(frozen=True)
class Run:
    """A log and the observer along it.

    stretch: rows of the log, and what the observer said there
    observer: that said it
    is_whole: whether these are all rows of the log
    build: of the observer, as in `estimate_log`
    warnings: what in the log does not look like the model's signals
    """

    stretch: Stretch
    observer: SampledObserver
    is_whole: bool
    build: str
    warnings: tuple[str, ...]

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return len(self.stretch.log.time)


@dataclass(frozen=True)
class Setup:
    """What is told before a fit.

    values: of all parameters of the observer, and the offsets that were found, as `<output>_bias`
    free: parameters of the model that are fitted, and offsets of outputs
    hold: share of the rows, the last ones, that is held out
    native: folder of native FMUs, as in `estimate_log`
    piece: rows of a piece of the record, at least
    """

    model: Model
    equations: Equations
    values: Mapping[str, Any]
    free: tuple[str, ...]
    hold: float
    native: Path | None
    piece: int = PIECE

    def check(self) -> None:
        """Raise UsageError for what cannot be fitted."""
        eq = self.equations
        known = [*eq.parameters, *offset_names(eq)]
        for name in self.free:
            if name not in known:
                raise UsageError.report(
                    "--free",
                    expected=one_of("parameter or offset", known, name),
                    received=repr(name),
                    likely=nearest(name, known),
                )
        check_offsets(eq, self.values, self.free)
        if not 0.0 <= self.hold <= 0.9:
            raise UsageError.report("--hold", expected="a share of the rows from 0 to 0.9", received=f"{self.hold:g}")
        check_smoothed("fit", eq, self._observer(self._first_values))

    def online(self, path: str | Path, names: Mapping[str, str] | None, units: Mapping[str, str] | None) -> Run:
        """Run the observer along the first block of a log."""
        block = first_block(self.equations, path, names, units)
        if block.rows < _LEAST_ROWS:
            raise UsageError.report(
                str(path),
                expected=f"at least {_LEAST_ROWS} rows of different times for a fit",
                received=str(block.rows),
                likely=next(iter(block.log.found.warnings), ""),
            )
        begin(f"fitting, part 1 of 5: running the observer along {block.rows} rows")
        steps = block.rows + TRIED * min(block.rows, MOST_ROWS)
        observer, found = self._run({**self._first_values, **self.open_offsets(block.log)}, block.log, steps)
        return Run(found.stretch, observer, block.is_whole, found.build, found.warnings)

    def along(self, changes: Mapping[str, Any], run: Run, rows: int) -> Online:
        """Return what an observer with changed values says along the first rows of a log."""
        log = run.stretch.rows(slice(rows)).log
        log = replace(log, outputs=log.outputs - self._offset)
        return self._run({**self.values, **changes}, log, len(log.time))[1].stretch.online

    def open_offsets(self, log: Log) -> dict[str, float]:
        """Return standard deviations of the free offsets, with which they are estimated until they are fitted."""
        return open_offsets(self.equations, self.values, self.free, log)

    @property
    def _offset(self) -> Array:
        """The offsets (p,) of the outputs that were found."""
        return np.array([self.values.get(name, 0.0) for name in offset_names(self.equations)])

    @property
    def _first_values(self) -> dict[str, Any]:
        """Values of the observer that runs along the log first, which needs a model of the disturbance."""
        return {**self.values, "disturbance_order": max(1, self.values["disturbance_order"])}

    def _run(self, values: Mapping[str, Any], log: Log, steps: int) -> tuple[SampledObserver, ObserverRun]:
        """Run an observer along a log; steps: that observers of the model take in all."""
        known = self._known({**values, "lag": 0.0})
        observer = self._observer(known)
        return observer, run_along(self.model, observer, known, self.native, log, steps)

    def problem(self, run: Run, order: int) -> Problem:
        """Return what a class of disturbances of an order is fitted to."""
        fitted = {name: 0.0 for name in offset_names(self.equations) if name in self.free}
        observer = self._observer({**fitted, **self.values, **self._pace(order), "lag": 0.0})
        usual, log = run.stretch.usual, run.stretch.log
        tuned = observer.tuned(usual)
        told = np.broadcast_to(tuned.model.noise_variance, log.outputs.shape)
        names, offset = [*self.equations.parameters, *offset_names(self.equations)], self._offset
        free, numbers = tuple(map(names.index, self.free)), [*tuned.model.parameters, *offset]
        prior = [self._prior(name, numbers[i]) for name, i in zip(self.free, free, strict=True)]
        rows = RowModel(tuned.model, row_functions(self.model))
        samples = Samples(run.stretch.step[:-1], log.inputs, log.outputs, told)
        return Problem(
            rows=rows,
            samples=while_moving(rows, samples, _trajectory(run, rows.model.layout)),
            intensity=tuned.intensity(usual, [1.0] * log.outputs.shape[1]),
            offset=offset,
            free=free,
            parameter_std=np.array(prior),
            trained=run.rows - round(self.hold * run.rows),
            spacing=_SPACING,
            piece=self.piece,
        )

    def trajectory(self, run: Run, problem: Problem) -> Array:
        """Return ξ (K,N) along a log by the observer's estimate."""
        return _trajectory(run, problem.layout)

    def tuned(self, changes: Mapping[str, Any], H: float) -> Tuned:
        """Return what an observer with changed values is tuned to at a step H (s)."""
        return self._observer({**self.values, **changes}).tuned(H)

    def named(self, name: str, of_disturbances: Iterable[float]) -> dict[str, float]:
        """Return the observer's parameters `name` of each disturbance with their values (q2,)."""
        names = for_each_disturbance(name, self.equations.disturbances).values()
        return dict(zip(names, map(float, of_disturbances), strict=True))

    @property
    def own_orders(self) -> dict[str, int]:
        """The orders of single disturbances of several, which have a parameter of their own; 0: as all."""
        names = for_each_disturbance(OWN_ORDER, self.equations.disturbances).values()
        return {name: int(self.values[name]) for name in names if name in self.values}

    @property
    def with_one_order(self) -> Setup:
        """The same with one order for all disturbances."""
        return self.with_values(dict.fromkeys(self.own_orders, 0))

    def of_disturbances(self, name: str) -> Array:
        """Return the parameter `name` of each disturbance (q2,)."""
        return np.array(for_disturbances(self.equations, self.values.__getitem__, name), dtype=float)

    def with_values(self, changes: Mapping[str, Any]) -> Setup:
        """Return the same with other values."""
        return replace(self, values={**self.values, **changes})

    def _pace(self, order: int) -> dict[str, Any]:
        """Return the order, and rates that are as fast as those that were told for another one."""
        told = max(1, self.values["disturbance_order"])
        bound, rate = self.of_disturbances("disturbance_bound"), self.of_disturbances("disturbance_rate")
        return {
            "disturbance_order": order,
            **self.named("disturbance_rate", bound * (rate / bound) ** (order / told)),
        }

    def _observer(self, values: Mapping[str, Any]) -> SampledObserver:
        """Return the observer for values, with no uncertain parameters and no unknown ones of the offsets in them."""
        return told_observer(self.equations, self._known(values).__getitem__, ignored)

    def _known(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return values with no uncertain parameters and no unknown ones of the offsets in them."""
        offsets = [name for name in offset_names(self.equations) if name in values]
        return {**values, **{f"{name}_std": 0.0 for name in (*self.equations.parameters, *offsets)}}

    def _prior(self, name: str, value: float) -> float:
        told = float(self.values[f"{name}_std"])
        return told or _OPEN * abs(value) or 1.0


def _trajectory(run: Run, layout: Layout) -> Array:
    """Return ξ (K,N) in a layout along a log by the observer's estimate."""
    said = unpacked_rows(run.observer.layout, run.stretch.online.predicted)
    return in_layout(said, run.observer.layout, layout)
