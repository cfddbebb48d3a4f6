"""The observer over a log: what it estimated, what the smoother adds, and what the residuals say, in one folder."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.row_functions import row_functions
from ndob_fmu.interface.told_observer import for_disturbances, told_observer, values_of
from ndob_fmu.log.diagnostics import OutputDiagnosis, ResidualTally
from ndob_fmu.log.estimate_figures import Thinned, write_figures
from ndob_fmu.log.log import Found
from ndob_fmu.log.log_columns import Signals
from ndob_fmu.log.native_run import build_of, native_run
from ndob_fmu.log.online import Run, Stretch, along
from ndob_fmu.log.plausible import plausibility, with_likely_cause
from ndob_fmu.log.read_log import read_log
from ndob_fmu.log.result_table import LOG, OBSERVER, ResultTable, table_lines
from ndob_fmu.log.smooth.misfit import said_of_misfit
from ndob_fmu.log.smooth.smooth_log import SmoothedStretch, smooth, start_samples
from ndob_fmu.log.smooth.smoothable import not_smoothed
from ndob_fmu.log.told import Told
from ndob_fmu.log.told_values import told_values
from ndob_fmu.model.model import Model
from ndob_fmu.results.csv_files import write_csv_parts
from ndob_fmu.results.recording import Recording
from ndob_fmu.results.run_files import RESULT, write_summary
from ndob_fmu.results.shown_time import ShownTime, shown_time
from ndob_fmu.results.versions import software_versions
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.step.channel_observer import read_out
from ndob_fmu.runtime.step.observer import Observer
from ndob_fmu.runtime.step.sampled_observer import SampledObserver
from ndob_fmu.support.files import atomic_folder
from ndob_fmu.support.progress import begin

# An interval that is so many times the usual one is a gap.
_GAP = 5.0


@dataclass(frozen=True)
class Estimated:
    """What was found in a log.

    build: of the observer that ran along it, PYTHON or NATIVE
    found: irregularities of its rows
    start_time, stop_time: of its first and last row (s)
    step: the usual interval between two rows (s); jitter: the standard deviation of the intervals over it
    gaps: intervals longer than five usual ones, which `jitter` leaves out
    valid: share of the rows with a valid estimate
    jumps, outliers: that the smoother found; None where there is no smoothed estimate
    offsets: that it found at the end of the log, for each output that has an unknown one
    diagnoses: of each output, by its name
    verdicts: what is wrong with a setting and what to change, one line each
    warnings: what the samples cannot tell apart
    """

    build: str
    found: Found
    start_time: float
    stop_time: float
    step: float
    jitter: float
    gaps: int
    valid: float
    jumps: int | None
    outliers: int | None
    offsets: Mapping[str, Told]
    diagnoses: Mapping[str, OutputDiagnosis]
    verdicts: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def shown_time(self) -> ShownTime:
        """How people read its times."""
        return shown_time(self.start_time, self.step)


def estimate_log(
    model: Model,
    path: str | Path,
    folder: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    start_values: Mapping[str, Any] | None = None,
    native: Path | None = None,
) -> Estimated:
    """Run the observer of a model over a log; write result.csv, summary.json and figures into a folder.

    names: the model's name for each column of the log that has another one
    units: of columns that are not in the model's unit
    start_values: of the observer's parameters, in place of the model's
    native: folder of native FMUs; that of this model's observer takes the steps, or `kept_observer`, which is built for
        a long log; where there is neither, Python does

    All files are written or none. Raises UsageError for a log or values that cannot be used, DesignError and
    AssumptionError where the observer cannot be designed, IntegrationError where its estimate leaves the finite
    numbers.
    """
    began = time.perf_counter()
    eq = compile_model(model)
    values = told_values(eq, start_values or {})
    warnings: list[str] = []
    sampled = told_observer(eq, values.__getitem__, warnings.append)
    parameters, x_hat = (
        values_of(values.__getitem__, eq.parameters),
        values_of(values.__getitem__, eq.states, "_hat_start"),
    )
    bound = for_disturbances(eq, values.__getitem__, "disturbance_bound")
    observer: Observer[Any] = read_out(eq, parameters, sampled, disturbance_bound=bound, lag=values["lag"])
    smooths = not_smoothed(eq, sampled) is None

    check = plausibility(eq, sampled, bound, x_hat)
    blocks = check.blocks(read_log(path, Signals(eq.inputs, eq.outputs, eq.units, names or {}, units or {})))
    first = next(blocks)
    before = observer.estimate(observer.init(x_hat), first.outputs[0].tolist())
    check.start(first.outputs[0], before)
    biased = [eq.outputs[i] for i in sampled.layout.biased]
    table, kept = ResultTable(eq, before, biased, smooths=smooths), Thinned()
    counts, tally = _Counts(biased, len(eq.outputs)), ResidualTally(len(eq.outputs), start_samples(sampled))

    def rows(run: Run | None) -> Iterator[Recording]:
        stretches = along(observer, x_hat, chain([first], blocks), run)
        for stretch, smoothed in (
            smooth(sampled, row_functions(model), x_hat, stretches)
            if smooths
            else ((stretch, None) for stretch in stretches)
        ):
            counts.add(stretch, smoothed)
            tally.add(stretch)
            check.add(stretch)
            yield kept.add(table.rows(stretch, smoothed))
            begin(f"estimating, {stretch.log.time[-1] - first.time[0]:.6g} s of the log are done")

    with atomic_folder(folder) as new:
        # Values in another unit overflow in the equations, of which an error or a warning of ours tells.
        with (
            native_run(model, native, values, observer, x_hat, len(first.time)) as run,
            np.errstate(over="ignore", invalid="ignore"),
        ):
            try:
                write_csv_parts(new / RESULT, rows(run), table_lines)
            except IntegrationError as error:
                raise IntegrationError(with_likely_cause(str(error), check.warnings())) from error
        diagnoses = dict(zip(eq.outputs, tally.diagnoses(), strict=True))
        verdicts, build = _verdicts(eq, sampled, diagnoses), build_of(run)
        warnings = [*warnings, *check.warnings(), *said_of_misfit(eq, counts.misfit)]
        estimated = counts.estimated(build, diagnoses, verdicts, tuple(warnings), smooths=smooths)
        disturbances, outputs = _with_units(eq, eq.disturbances), _with_units(eq, eq.outputs)
        write_figures(new, kept, disturbances, outputs, diagnoses, estimated.shown_time, smooths=smooths)
        wall_time = time.perf_counter() - began
        write_summary(new, _summary(eq, values, estimated, table.units, Path(path).name, wall_time))
    return estimated


class _Counts:
    """What is counted while a log passes."""

    def __init__(self, biased: Sequence[str], outputs: int) -> None:
        self._biased, self._offsets = biased, dict[str, Told]()
        self._found, self._rows, self._valid, self._jumps, self._outliers = Found(), 0, 0.0, 0, 0
        self.misfit = np.zeros((2, outputs))
        self._first, self._last, self._usual, self._gaps = 0.0, 0.0, 0.0, 0
        self._sums = np.zeros(3)

    def add(self, stretch: Stretch, smoothed: SmoothedStretch | None) -> None:
        """Count a stretch."""
        log = stretch.log
        if not self._rows:
            self._first, self._usual = float(log.time[0]), stretch.usual
        self._last = float(log.time[-1])
        steps = stretch.step / self._usual
        usual = steps[steps <= _GAP]
        self._gaps += len(steps) - len(usual)
        self._sums += [len(usual), usual.sum(), (usual**2).sum()]
        self._found += log.found
        self._rows += len(log.time)
        self._valid += float(stretch.online.valid.sum())
        if smoothed is not None:
            self._jumps, self._outliers = self._jumps + smoothed.jumps, self._outliers + smoothed.outliers
            self.misfit = np.maximum(self.misfit, smoothed.misfit)
            last = zip(self._biased, smoothed.offset[-1].tolist(), smoothed.offset_std[-1].tolist(), strict=True)
            self._offsets = {name: Told(value, std) for name, value, std in last}

    def estimated(
        self,
        build: str,
        diagnoses: Mapping[str, OutputDiagnosis],
        verdicts: tuple[str, ...],
        warnings: tuple[str, ...],
        *,
        smooths: bool,
    ) -> Estimated:
        """Return what was found."""
        count, total, squares = self._sums.tolist()
        mean = total / count
        return Estimated(
            build=build,
            found=self._found,
            start_time=self._first,
            stop_time=self._last,
            step=self._usual,
            jitter=max(squares / count - mean**2, 0.0) ** 0.5,
            gaps=self._gaps,
            valid=self._valid / self._rows,
            jumps=self._jumps if smooths else None,
            outliers=self._outliers if smooths else None,
            offsets=self._offsets,
            diagnoses=diagnoses,
            verdicts=verdicts,
            warnings=warnings,
        )


def _verdicts(eq: Equations, observer: SampledObserver, diagnoses: Mapping[str, OutputDiagnosis]) -> tuple[str, ...]:
    return tuple(
        line
        for (name, found), std in zip(diagnoses.items(), observer.noise_std.tolist(), strict=True)
        for line in found.verdicts(name, std, eq.units.get(name, ""))
    )


def _with_units(eq: Equations, names: Sequence[str]) -> list[tuple[str, str]]:
    return [(name, eq.units.get(name, "") or "1") for name in names]


def _summary(
    eq: Equations, values: Mapping[str, Any], found: Estimated, units: Mapping[str, str], log: str, wall_time: float
) -> dict[str, Any]:
    return {
        "system": log,
        "step_size": found.step,
        "stop_time": found.stop_time,
        "connections": {f"{OBSERVER}.{name}": [f"{LOG}.{name}", 1.0, 0.0] for name in (*eq.inputs, *eq.outputs)},
        "parameters": {f"{OBSERVER}.{name}": value for name, value in values.items()},
        "units": dict(units),
        "versions": software_versions(),
        "wall_time": wall_time,
        "estimate": asdict(found),
    }
