"""The observer along the first block of a log, with which `fit` and `tune` begin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.interface.told_observer import values_of
from ndob_fmu.log.log import Log
from ndob_fmu.log.log_columns import Signals
from ndob_fmu.log.native_run import build_of, native_run
from ndob_fmu.log.online import Stretch, along
from ndob_fmu.log.plausible import plausibility, with_likely_cause
from ndob_fmu.log.read_log import read_log
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.step.sampled_observer import SampledObserver


@dataclass(frozen=True)
class Block:
    """The first block of a log; `is_whole`: whether it has all rows."""

    log: Log
    is_whole: bool

    @property
    def rows(self) -> int:
        """How many rows it has."""
        return len(self.log.time)


@dataclass(frozen=True)
class ObserverRun:
    """What an observer says along a block.

    build: of the observer, as in `Estimated`
    warnings: what does not look like the model's signals, one line each
    """

    stretch: Stretch
    build: str
    warnings: tuple[str, ...]


def first_block(
    eq: Equations, path: str | Path, names: Mapping[str, str] | None, units: Mapping[str, str] | None
) -> Block:
    """Return the first block of a log. Raises UsageError for a log that cannot be used."""
    blocks = read_log(path, Signals(eq.inputs, eq.outputs, eq.units, names or {}, units or {}))
    return Block(next(blocks), is_whole=next(blocks, None) is None)


def run_along(
    model: Model, observer: SampledObserver, values: Mapping[str, Any], native: Path | None, block: Log, steps: int
) -> ObserverRun:
    """Run an observer of a model along a block.

    values: of all parameters, which the observer has
    native: folder of native FMUs, as in `estimate_log`
    steps: that observers of the model take in all, in this run and in later ones

    Raises UsageError for a gap that cannot be bridged, DesignError where the observer has no tuning for the usual step,
    IntegrationError where its estimate leaves the finite numbers.
    """
    eq = compile_model(model)
    x_hat = values_of(values.__getitem__, eq.states, "_hat_start")
    check = plausibility(eq, observer, observer.settings.disturbance_bound, x_hat)
    first = block.outputs[0]
    check.start(first, observer.estimate(observer.init(x_hat), first.tolist()))
    # Values in another unit overflow in the equations, of which an error or a warning of ours tells.
    with (
        native_run(model, native, values, observer, x_hat, steps) as run,
        np.errstate(over="ignore", invalid="ignore"),
    ):
        try:
            stretch = next(along(observer, x_hat, check.blocks(iter([block])), run))
        except IntegrationError as error:
            raise IntegrationError(with_likely_cause(str(error), check.warnings())) from error
    check.add(stretch)
    return ObserverRun(stretch, build_of(run), tuple(check.warnings()))
