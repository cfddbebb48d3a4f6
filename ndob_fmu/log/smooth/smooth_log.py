"""The smoothed estimate of a log: what all of its samples, earlier and later ones, say about each row."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ndob_fmu.codegen.row_functions import RowFunctions
from ndob_fmu.log.online import SURE_OF_NOISE, Stretch
from ndob_fmu.log.smooth.along import Course, Samples, Start, intensities, unpacked_rows
from ndob_fmu.log.smooth.event_search import explained_from
from ndob_fmu.log.smooth.events import Events, Explained, Jumps, with_events
from ndob_fmu.log.smooth.held_steps import held_at_first, limited
from ndob_fmu.log.smooth.jump_instants import mixed
from ndob_fmu.log.smooth.linear_record import LinearRecord, Smoothed
from ndob_fmu.log.smooth.misfit import ModelError, error_of_model, is_followed, no_error
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.whole_record import WholeRecord
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.step.adaptive_noise import in_use
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.sampled_observer import SampledObserver
from ndob_fmu.runtime.step.tracking_step import as_published
from ndob_fmu.runtime.step.tuned import Tuned, filter_model

# Rows of the next stretch that a stretch is smoothed with; later samples say nothing more about it.
_LOOK_AHEAD = 2000
_LEAST_SPACING = 3
# A disturbance that may be so many times as fast can do anything.
_FREE = 100.0


@dataclass(frozen=True)
class SmoothedStretch:
    """The smoothed estimate at the rows of a stretch.

    x, x_std (K,n), d, d_std (K,q2): states and disturbances with their error bars
    offset, offset_std (K,·): of the outputs that have an unknown one, likewise
    jumps, outliers: how many were found
    misfit (2,p): the `ModelError.sizes`
    """

    x: Array
    x_std: Array
    d: Array
    d_std: Array
    offset: Array
    offset_std: Array
    jumps: int
    outliers: int
    misfit: Array


def start_samples(observer: SampledObserver) -> int:
    """Return how many samples the start lasts."""
    return filter_model(observer, 1.0, 0.0).start_samples


def event_spacing(tuned: Tuned) -> int:
    """Return within how many rows there is one new event."""
    return max(_LEAST_SPACING, round(2.0 * tuned.model.jump_spacing / tuned.H))


def smooth(
    observer: SampledObserver, functions: RowFunctions, x_hat: Vector, stretches: Iterator[Stretch]
) -> Iterator[tuple[Stretch, SmoothedStretch]]:
    """Yield each stretch of a log with its smoothed estimate, for an observer that ran along it from x̂₀ (n,).

    functions: the model's equations for many rows

    A stretch is smoothed together with the first rows of the next one.

    Raises IntegrationError where the equations cannot be followed.
    """
    stretch = next(stretches)
    tuned = observer.tuned(stretch.usual)
    equations = RowModel(tuned.model, functions)
    xi = observer.layout.unpacked(observer.init(x_hat).xi_hat)
    start, started = Start(xi, np.diag(tuned.model.start_std)), tuned.model.start_samples
    while True:
        following = next(stretches, None)
        part = stretch if following is None else stretch.and_then(following.rows(slice(_LOOK_AHEAD)))
        found, K = explained_stretch(tuned, equations, part, start, started), len(stretch.log.time)
        yield stretch, found.smoothed(K)
        if following is None:
            return
        run = found.explained.forward
        start = Start(found.course.trajectory[K] + run.xi[K], run.factor[K])
        started = 0
        stretch = following


@dataclass(frozen=True)
class ExplainedStretch:
    """A stretch of a log as its events and the model's error explain it.

    course: about which the equations are linear
    columns: of jumps, at each of its rows
    """

    course: Course
    explained: Explained
    columns: Jumps
    error: ModelError

    def smoothed(self, rows: int) -> SmoothedStretch:
        """Return the smoothed estimate at the first rows."""
        equations, found, inputs = self.course.rows, self.explained, self.course.samples.inputs
        about, held = self.course.trajectory, self.course.samples.held
        model, n, places = equations.model, equations.model.layout.n, equations.model.layout.disturbance
        all_rows = Smoothed(found.forward, found.adjoint)
        xi, std = about + all_rows.xi, all_rows.std
        d, variance = mixed(found, self.columns, xi[:, places], std[:, places] ** 2)
        if held is not None:
            d, variance = limited(equations, held, xi, all_rows.covariance, inputs, d, variance)
        xi, std = xi[:rows], std[:rows]
        more = equations.taken_for_disturbance(about[:rows], inputs[:rows])
        d, d_std = as_published(model, d[:rows], variance[:rows] + more)
        return SmoothedStretch(
            x=xi[:, :n],
            x_std=std[:, :n],
            d=d,
            d_std=d_std,
            offset=xi[:, model.layout.biases],
            offset_std=std[:, model.layout.biases],
            jumps=sum(k < rows for k in found.events.jumps),
            outliers=sum(k < rows for k, _ in found.events.outliers),
            misfit=self.error.sizes,
        )


def explained_stretch(tuned: Tuned, equations: RowModel, part: Stretch, start: Start, started: int) -> ExplainedStretch:
    """Return a stretch as its events and the model's error explain it.

    started: rows of the start, in which the disturbance is unknown anyway

    The equations are linearised along the online estimate, then along the smoothed one.
    """
    model, said = tuned.model, part.online
    about, inputs = unpacked_rows(model.layout, said.predicted), part.log.inputs
    samples = Samples(part.step[:-1], inputs, part.log.outputs, noise_variance(model, said.noise_ratio))
    if model.equations.surfaces is not None:
        samples = replace(samples, held=held_at_first(equations, about, inputs, passing=True))
    events = Events(outliers=frozenset((int(k), int(i)) for k, i in np.argwhere(said.refused > 0.0)))
    spacing = event_spacing(tuned)
    intensity = intensities(tuned, samples.step)

    def linearised(trajectory: Array, events: Events) -> ExplainedStretch:
        course = Course(equations, samples, trajectory)

        def record_of(factor: float) -> tuple[LinearRecord, Jumps]:
            return course.record(start, factor * intensity, course.plan, apart=False)

        record, columns = record_of(1.0)
        whole, state_std = WholeRecord(record), model.start_std[: model.layout.n]
        found, error = with_events(whole, columns, events), no_error(record)
        if not is_followed(found.forward):
            free, _ = record_of(_FREE**2)
            error = error_of_model(record, free, columns, events, state_std, samples.step)
            whole = WholeRecord(error.added_to(record, state_std, samples.step))
            found = with_events(whole, columns, events)
        return ExplainedStretch(course, explained_from(found, whole, columns, spacing, started), columns, error)

    if not model.is_linear:
        found = linearised(about, events).explained
        smoothed = Smoothed(found.forward, found.adjoint)
        about, events = about + smoothed.xi, found.events
        if samples.held is not None:
            held = samples.held.looked_at_again(equations, about, smoothed.covariance, inputs)
            held, events = held.widened(spacing).with_hidden(events)
            samples = replace(samples, held=held)
    return linearised(about, events)


def noise_variance(model: FilterModel, ratio: Array) -> Array:
    """Return the variances of the samples (K,p), for ratios (K,p) that follow the residuals."""
    if not model.adapts:
        return np.broadcast_to(model.noise_variance, ratio.shape)
    first = min(SURE_OF_NOISE, len(ratio) - 1)
    believed = np.concatenate([np.broadcast_to(ratio[first], (first, ratio.shape[1])), ratio[first:]])
    used = in_use(believed.ravel().tolist(), np.tile(model.least_noise, len(believed)).tolist())
    return np.asarray(model.noise_variance * np.reshape(used, believed.shape))
