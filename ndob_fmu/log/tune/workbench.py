"""What a log says with other settings: the linearised filter over it, in a part of a second.

The observer runs along the log once, with the values that were told. Its equations are linearised along the smoothed
estimate, and the jumps and outliers are found. With other settings the same linear record is filtered with other noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.row_functions import row_functions
from ndob_fmu.interface.told_observer import for_disturbances, told_observer, values_of
from ndob_fmu.log.diagnostics import OutputDiagnosis, ResidualTally
from ndob_fmu.log.first_block import first_block, run_along
from ndob_fmu.log.smooth.along import Course, Start, in_layout, intensities
from ndob_fmu.log.smooth.event_search import explained
from ndob_fmu.log.smooth.events import Events, Explained, Jumps, with_events
from ndob_fmu.log.smooth.jump_instants import mixed
from ndob_fmu.log.smooth.linear_record import Adjoint, Forward, LinearRecord, Smoothed
from ndob_fmu.log.smooth.misfit import said_of_misfit
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.smooth_log import event_spacing, explained_stretch, noise_variance
from ndob_fmu.log.smooth.smoothable import check_smoothed
from ndob_fmu.log.smooth.whole_record import WholeRecord
from ndob_fmu.log.told_values import ignored, told_values
from ndob_fmu.log.tune.lagged import lagged_adjoint
from ndob_fmu.log.tune.settings import Settings, settings_of
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.sampled_observer import SampledObserver
from ndob_fmu.runtime.step.tracking_step import as_published
from ndob_fmu.runtime.step.tuned import Tuned
from ndob_fmu.support.progress import begin

_REMEMBERED = 16


@dataclass(frozen=True)
class Band:
    """A disturbance estimate (K,q2) and its error bar (K,q2)."""

    d: Array
    std: Array


@dataclass(frozen=True)
class Shown:
    """What the linearised filter says of a log.

    online, lagged, smoothed: estimates from the samples up to a row, up to a lag behind it, and from all; lagged is
    None without a lag
    residual, residual_std (K,p): innovations; NaN where nothing was measured
    jumps, outliers: how many are known
    diagnoses: of each output, by its name; verdicts: one line each
    """

    online: Band
    lagged: Band | None
    smoothed: Band
    residual: Array
    residual_std: Array
    jumps: int
    outliers: int
    diagnoses: Mapping[str, OutputDiagnosis]
    verdicts: tuple[str, ...]


@dataclass(frozen=True)
class _Linear:
    """A log about a trajectory (K,N), in the layout of an order: the record and the columns of jumps.

    sizes (K-1,c): of the noise in the record
    more (K,q2): variance of d̂ by parameters, as in `RowModel.taken_for_disturbance`
    """

    trajectory: Array
    record: LinearRecord
    columns: Jumps
    sizes: Array
    more: Array


class Workbench:
    """A log, which `shown` filters with any settings. It remembers what is costly. Not for several threads at once.

    Only the first 30 000 rows are read; `native` is as in `estimate_log`. `warnings` say what in the log does not look
    like the model's signals. Raises UsageError for a log or values that
    cannot be used, DesignError and AssumptionError where the observer cannot be designed, IntegrationError where its
    estimate leaves the finite numbers.
    """

    def __init__(
        self,
        model: Model,
        path: str | Path,
        *,
        names: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        start_values: Mapping[str, Any] | None = None,
        native: Path | None = None,
    ) -> None:
        self.equations = eq = compile_model(model)
        self._values = told_values(eq, start_values or {})
        self._given = {name: self._values[name] for name in start_values or {}}
        self._functions = row_functions(model)
        self._linear: dict[int, _Linear] = {}
        self._tunings: dict[Settings, tuple[SampledObserver, Tuned]] = {}
        self._latest: tuple[tuple[Settings, Events], Tuned, _Linear, Explained] | None = None
        self.told = settings_of(eq, self._values)
        observer = self._observer(self.told)
        check_smoothed("tune", eq, observer)
        block = first_block(eq, path, names, units)
        begin(f"running the observer along {block.rows} rows of the log")
        run = run_along(model, observer, self._values, native, block.log, block.rows)
        self.stretch = run.stretch
        begin("finding jumps and outliers")
        _, tuned = self._tuned(self.told)
        rows = RowModel(tuned.model, self._functions)
        found = explained_stretch(
            tuned, rows, self.stretch, self._start(observer, tuned.model), tuned.model.start_samples
        )
        self._about, self._error, self._events = found.course, found.error, found.explained.events
        self.warnings = (*run.warnings, *said_of_misfit(eq, self._error.sizes))

    @property
    def bound(self) -> list[float]:
        """D₀ (q2,), of each disturbance."""
        return for_disturbances(self.equations, self._values.__getitem__, "disturbance_bound")

    def start_values(self, settings: Settings) -> dict[str, Any]:
        """Return what was told, with the settings: the content of `fit.json`."""
        return {**self._given, **settings.start_values(self.equations)}

    def shown(self, settings: Settings) -> Shown:
        """Return what the linearised filter says with the known jumps and outliers.

        Raises DesignError where the observer has no tuning for the settings.
        """
        key = (_without_lag(settings), self._events)
        if self._latest is None or self._latest[0] != key:
            tuned, linear, record = self._record(settings)
            self._latest = (key, tuned, linear, with_events(record, linear.columns, self._events))
        return self._as_shown(settings, *self._latest[1:])

    def find_jumps(self, settings: Settings) -> None:
        """Find the jumps and outliers that explain the log with these settings, in place of those that were known."""
        tuned, linear, record = self._record(settings)
        spacing, started = event_spacing(tuned), tuned.model.start_samples
        self._events = explained(record, linear.columns, spacing, started, self._events).events

    def _observer(self, settings: Settings) -> SampledObserver:
        values = {**self._values, **settings.start_values(self.equations)}
        return told_observer(self.equations, values.__getitem__, ignored)

    def _tuned(self, settings: Settings) -> tuple[SampledObserver, Tuned]:
        """Return the observer for settings, and what it is tuned to."""
        key = _without_lag(settings)
        if key not in self._tunings:
            observer = self._observer(settings)
            if len(self._tunings) >= _REMEMBERED:
                self._tunings.pop(next(iter(self._tunings)))
            self._tunings[key] = (observer, observer.tuned(self.stretch.usual))
        return self._tunings[key]

    def _start(self, observer: SampledObserver, model: FilterModel) -> Start:
        x_hat = values_of(self._values.__getitem__, self.equations.states, "_hat_start")
        return Start(model.layout.unpacked(observer.init(x_hat).xi_hat), np.diag(model.start_std))

    def _record(self, settings: Settings) -> tuple[Tuned, _Linear, WholeRecord]:
        """Return the record with the noise of the settings."""
        observer, tuned = self._tuned(settings)
        model = tuned.model
        if settings.order not in self._linear:
            self._linear[settings.order] = self._linearised(observer, tuned)
        linear = self._linear[settings.order]
        c, N = linear.sizes.shape[1], model.layout.size
        noise = linear.record.noise.copy()
        noise[:, :, : c * N] *= np.repeat(self._noise_sizes(tuned) / linear.sizes, N, axis=1)[:, None]
        record = replace(
            linear.record,
            noise=noise,
            variance=noise_variance(model, self._noise_ratio(settings)),
            start_factor=np.diag(model.start_std),
        )
        with_error = self._error.added_to(record, model.start_std[: model.layout.n], self.stretch.step[:-1])
        return tuned, linear, WholeRecord(with_error)

    def _noise_ratio(self, settings: Settings) -> Array:
        """Return the variance (K,p) that the observer found in the residuals, over the one of the settings."""
        told, new = np.array(self.told.noise_std), np.array(settings.noise_std)
        return np.asarray(self.stretch.online.noise_ratio * (told / new) ** 2)

    def _linearised(self, observer: SampledObserver, tuned: Tuned) -> _Linear:
        model, log = tuned.model, self.stretch.log
        told = np.broadcast_to(model.noise_variance, log.outputs.shape)
        rows, about = RowModel(model, self._functions), self._about
        trajectory = in_layout(about.trajectory, about.rows.model.layout, model.layout)
        course = Course(rows, replace(about.samples, noise_variance=told), trajectory)
        start, intensity = self._start(observer, model), intensities(tuned, self.stretch.step[:-1])
        record, columns = course.record(start, intensity, course.plan, apart=True)
        more = rows.taken_for_disturbance(trajectory, log.inputs)
        return _Linear(trajectory, record, columns, self._noise_sizes(tuned), more)

    def _noise_sizes(self, tuned: Tuned) -> Array:
        """Return the square roots of the noise's intensities (K-1,c) in the steps."""
        step = self.stretch.step[:-1]
        return RowModel(tuned.model, self._functions).noise_sizes(intensities(tuned, step), step)

    def _as_shown(self, settings: Settings, tuned: Tuned, linear: _Linear, found: Explained) -> Shown:
        model, run, eq = tuned.model, found.forward, self.equations
        measured = np.isfinite(run.alpha)
        residual = np.where(measured, run.innovation, np.nan)
        residual_std = np.where(measured, np.sqrt(run.alpha), np.nan)
        diagnoses = dict(
            zip(eq.outputs, self._diagnoses(settings, model, found.events, residual, residual_std), strict=True)
        )
        rows = round(settings.lag / self.stretch.usual)
        return Shown(
            online=_filtered(model, linear, run),
            lagged=_with(model, linear, run, lagged_adjoint(found.record, run, rows)) if rows else None,
            smoothed=_smoothed(model, linear, found),
            residual=residual,
            residual_std=residual_std,
            jumps=len(found.events.jumps),
            outliers=len(found.events.outliers),
            diagnoses=diagnoses,
            verdicts=tuple(
                line
                for (name, one), std in zip(diagnoses.items(), settings.noise_std, strict=True)
                for line in one.verdicts(name, std, eq.units.get(name, ""))
            ),
        )

    def _diagnoses(
        self, settings: Settings, model: FilterModel, events: Events, residual: Array, residual_std: Array
    ) -> list[OutputDiagnosis]:
        refused = np.zeros_like(residual)
        for k, i in events.outliers:
            refused[k, i] = 1.0
        said = replace(
            self.stretch.online,
            residual=residual,
            residual_std=residual_std,
            refused=refused,
            noise_ratio=self._noise_ratio(settings),
        )
        tally = ResidualTally(len(self.equations.outputs), model.start_samples)
        tally.add(replace(self.stretch, online=said))
        return list(tally.diagnoses())


def _without_lag(settings: Settings) -> Settings:
    """Return settings for which the filter is the same whatever the lag is, as long as there is one."""
    return replace(settings, lag=float(settings.lag > 0.0))


def _filtered(model: FilterModel, linear: _Linear, run: Forward) -> Band:
    """Return the estimate from the samples up to each row."""
    d = model.layout.disturbance
    before = (run.factor[:, d] ** 2).sum(axis=2)
    alpha = np.where(np.isfinite(run.alpha), run.alpha, 0.0)
    gain = run.gain[:, :, d]
    value = linear.trajectory[:, d] + run.xi[:, d] + (gain * run.innovation[:, :, None]).sum(axis=1)
    variance = before - (gain**2 * alpha[:, :, None]).sum(axis=1)
    return Band(*as_published(model, value, np.maximum(variance, 0.0) + linear.more))


def _with(model: FilterModel, linear: _Linear, run: Forward, adjoint: Adjoint) -> Band:
    """Return the estimate with the later samples that an adjoint knows."""
    d = model.layout.disturbance
    xi, variance = Smoothed(run, adjoint).some(d)
    return Band(*as_published(model, linear.trajectory[:, d] + xi, variance + linear.more))


def _smoothed(model: FilterModel, linear: _Linear, found: Explained) -> Band:
    """Return the estimate with all samples."""
    d = model.layout.disturbance
    xi, variance = Smoothed(found.forward, found.adjoint).some(d)
    value, variance = mixed(found, linear.columns, linear.trajectory[:, d] + xi, variance)
    return Band(*as_published(model, value, variance + linear.more))
