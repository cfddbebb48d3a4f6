"""One class of disturbances fitted to a log: the noise, the pace, the jumps, and the parameters of the plant.

In turn, the equations are linearised along the smoothed estimate, noise, pace and events are found (`noise_fit`), and
the parameters take a step (`parameter_step`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import inf

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.fit.between_jumps import jump_sizes, raised
from ndob_fmu.log.fit.likelihood import Moved, likelihood
from ndob_fmu.log.fit.noise_fit import NoiseFit, NoiseLikelihood, fit_noise, is_jumping
from ndob_fmu.log.fit.parameter_step import Step
from ndob_fmu.log.fit.problem import Linearised, Problem
from ndob_fmu.log.fit.rare import are_usual
from ndob_fmu.log.smooth.along import in_layout
from ndob_fmu.log.smooth.event_search import explained
from ndob_fmu.log.smooth.events import Events, Explained, with_events
from ndob_fmu.log.smooth.linear_record import Smoothed
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.progress import go_on

_MOST_ROUNDS = 12
# A round that changes each number by less than this part of its standard deviation, and the logarithms of noise and
# pace by less than this, is the last one.
_SAME_IN_STD, _SAME = 0.1, 0.02
# A likelihood that is less than before by more than this shows a step that was too long.
_LESS = 0.5
# A step of a parameter, at most, in its prior standard deviations.
_LONGEST_STEP = 0.5
# Factors on the intensity with which jumps of held-out rows are found.
_LIVELY = (1e8, 1e5, 1e3, 10.0, 1.0)
# Within so many rows a disturbance is hardly told.
_CLOSE = 10

ParameterStep = Callable[[Problem, Array, Array, NoiseFit], Step]


@dataclass(frozen=True)
class HeldOut:
    """What a fit says of rows that were held out.

    value: log-likelihood of their samples, less the costs of their events
    samples: how many there are
    events: by the numbers of these rows
    """

    value: float
    samples: int
    events: Events

    @property
    def of_a_sample(self) -> float | None:
        """The log-likelihood of a sample, None where there is none."""
        return self.value / self.samples if self.samples else None


@dataclass(frozen=True)
class ClassFit:
    """What was found.

    about: all rows, linear about nearly the same trajectory
    noise: the noise of the samples, the pace and the events of the rows that were fitted
    parameters (n_θ,), covariance (n_θ,n_θ): θ
    trajectory (K,N), events: smoothed ξ of all rows, as one record, and the events in it
    """

    about: Linearised
    noise: NoiseFit
    parameters: Array
    covariance: Array
    trajectory: Array
    events: Events

    @property
    def problem(self) -> Problem:
        """What it was fitted to."""
        return self.about.problem

    @property
    def order(self) -> int:
        """Of the disturbance."""
        return self.problem.layout.order

    def in_layout_of(self, problem: Problem) -> Array:
        """Return the trajectory in the layout of a problem."""
        return in_layout(self.trajectory, self.problem.layout, problem.layout)

    @cached_property
    def held_out(self) -> HeldOut:
        """What the fit says of the held-out rows."""
        return _held_out(self.about, self.noise)

    @cached_property
    def is_jumping(self) -> bool:
        """Whether jumps explain more than chance."""
        problem = self.problem
        return is_jumping(*self.about.pieces(slice(problem.trained)), problem.layout, self.noise)

    @cached_property
    def raised(self) -> Array:
        """The factor on the intensity (q2,) with which the error bars hold."""
        return raised(self.about, self.noise) if self.is_jumping else np.ones(len(self.noise.log_intensity))

    @property
    def judged(self) -> float:
        """The log-likelihood of what was held out, or of all where nothing was."""
        return self.held_out.value if self.held_out.samples else self.noise.value

    def largest(self, about: Array) -> Array:
        """The largest distance (q2,) of smoothed disturbances from values (q2,).

        Few samples tell what it is between close jumps, or between a jump and an end of the log.
        """
        told = _told_rows(self.problem, self.trajectory, self.events)
        return np.asarray(np.max(np.abs(self.disturbance - about)[told], axis=0, initial=0.0))

    @property
    def residuals(self) -> Array:
        """Innovations (K,p) over their standard deviations, behind the start; NaN where nothing was measured."""
        run = with_events(self.about.whole(self.noise), self.about.columns, self.events).forward
        there = np.isfinite(run.alpha)
        known = np.where(there, run.innovation / np.sqrt(np.where(there, run.alpha, 1.0)), np.nan)
        return np.asarray(known[self.problem.rows.model.start_samples :])

    @property
    def with_held_out_events(self) -> ClassFit:
        """The same with the events of the held-out rows, too."""
        events = self.noise.events.and_then(self.held_out.events, self.problem.trained)
        return replace(self, noise=replace(self.noise, events=events))

    @property
    def disturbance(self) -> Array:
        """The smoothed disturbances (K,q2), without the start."""
        return _disturbance(self.problem, self.trajectory)

    @property
    def disturbance_rms(self) -> float:
        """Of the smoothed disturbances."""
        return _rms(self.problem, self.trajectory, self.events)

    @property
    def usual_rms(self) -> float:
        """Of the smoothed disturbances where they are not rare and large, as pulses."""
        return _rms_of(self.problem, self.disturbance, are_usual(self.disturbance))

    @property
    def jumping_rate(self) -> Array:
        """The rate (q2,) at which disturbances change by their jumps, in the mean; 0 where they do not jump."""
        jumps = sorted(self.noise.events.jumps)
        if not self.is_jumping:
            return np.zeros(len(self.noise.log_intensity))
        between = float(self.problem.samples.step[: self.problem.trained - 1].sum()) / len(jumps)
        sizes = jump_sizes(self.trajectory[:, self.problem.layout.disturbance], jumps)
        return np.asarray(sizes.mean(axis=0) / between**self.order)

    @property
    def tells_pace(self) -> bool:
        """Whether the record tells the intensity of each disturbance, at least within a factor of e."""
        q = len(self.noise.log_intensity)
        return bool(np.all(np.diag(self.noise_covariance)[-q:] < 1.0))

    @property
    def pace(self) -> tuple[Array, Array]:
        """The intensities (q2,) of what drives the disturbances, with their standard deviations."""
        q = len(self.noise.log_intensity)
        found = self.problem.intensity * np.exp(self.noise.log_intensity)
        return found, found * np.sqrt(np.diag(self.noise_covariance)[-q:])

    @cached_property
    def noise_covariance(self) -> Array:
        """Of the logarithms of noise and pace (p + q2,p + q2)."""
        record, search = self.about.pieces(slice(self.problem.trained))
        likelihood = NoiseLikelihood(record, self.problem.layout, search.columns)
        return np.asarray(np.linalg.inv(likelihood.precision(self.noise.logs, self.noise.events)))


def fit_class(
    problem: Problem,
    trajectory: Array,
    step_of: ParameterStep,
    *,
    start: ClassFit | None = None,
    climbs: bool = True,
    most_rms: float = inf,
) -> ClassFit:
    """Fit a class, from an estimate ξ (K,N) of all rows.

    step_of: the step of the parameters; climbs: whether it leads to a larger likelihood
    start: a fit of the same order, with whose noise and events to begin
    most_rms: of the smoothed disturbances; where it is larger, the fit ends early

    Raises IntegrationError where the equations cannot be followed.
    """
    theta, prior, before = problem.told, problem.parameter_std, None
    first = None if start is None else start.noise.for_intensity(start.problem.intensity, problem.intensity)
    train, at_best, events = slice(problem.trained), problem.told, None if start is None else start.events
    for turn in range(_MOST_ROUNDS):
        go_on(f"round {1 + turn} of {_MOST_ROUNDS} at most, disturbance_order {problem.layout.order}")
        course = problem.course(trajectory, theta)
        about = problem.about(course, course.plan)
        noise = fit_noise(*about.pieces(train), problem.layout, before or first)
        found = _explained(about, noise, noise.events if events is None else events)
        events = found.events
        trajectory = trajectory + Smoothed(found.forward, found.adjoint).xi
        if climbs and before is not None and noise.value < before.value - _LESS:
            theta = 0.5 * (theta + at_best)  # the step was too long
            continue
        at_best = theta
        step, std, covariance = np.zeros(0), np.zeros(0), np.zeros((0, 0))
        if len(prior):
            wanted, covariance, needed = step_of(problem, trajectory, theta, noise)
            std = np.sqrt(np.diag(covariance))
            # What is left to go where the search ends is not known, either: small, but where the likelihood is ragged.
            covariance = covariance + np.outer(wanted, wanted)
            step = np.clip(wanted, -_LONGEST_STEP * prior, _LONGEST_STEP * prior)
            noise = replace(noise, events=needed)
        if before is not None and _same(before, noise, step, std):
            break
        if _rms(problem, trajectory, found.events) > most_rms:
            break
        theta, before = theta + step, noise
    return ClassFit(about, noise, parameters=at_best, covariance=covariance, trajectory=trajectory, events=found.events)


def _explained(known: Linearised, noise: NoiseFit, events: Events) -> Explained:
    """Return all rows with the events of one record, which sees those that the start of a piece explains as well.

    events: to begin with
    """
    search = known.search(slice(None))
    return explained(known.whole(noise), search.columns, search.spacing, search.first, events)


def _held_out(about: Linearised, noise: NoiseFit) -> HeldOut:
    problem = about.problem
    if problem.trained == len(about.trajectory):
        return HeldOut(0.0, 0, Events())
    held, search = about.pieces(slice(problem.trained, None))
    told, events = noise.cut(held, problem.layout), Events()
    # A calm filter is lost after a jump that is not known yet, and finds no other one.
    for lively in _LIVELY:
        faster = replace(noise, log_intensity=noise.log_intensity + np.log(lively))
        events = search.within(faster.cut(held, problem.layout), events)
    value = likelihood(Moved(told, search.columns), [], events).value - events.costs
    return HeldOut(value, int(np.isfinite(held.whole.misfit).sum()), events)


def _disturbance(problem: Problem, trajectory: Array) -> Array:
    return trajectory[problem.rows.model.start_samples :, problem.layout.disturbance]


def _told_rows(problem: Problem, trajectory: Array, events: Events) -> NDArray[np.bool_]:
    """Return at which rows of `_disturbance` it is told: not between jumps, or a jump and an end, that are close."""
    told = np.ones(len(trajectory), dtype=bool)
    for one, other in pairwise([0, *sorted(events.jumps), len(told)]):
        told[one:other] = other - one > _CLOSE
    return told[problem.rows.model.start_samples :]


def _rms(problem: Problem, trajectory: Array, events: Events) -> float:
    """Return the root mean square of disturbances (K,q2), each over its bound, in the unit of the first one."""
    return _rms_of(problem, _disturbance(problem, trajectory), _told_rows(problem, trajectory, events)[:, None])


def _rms_of(problem: Problem, disturbance: Array, counts: NDArray[np.bool_]) -> float:
    """Return the root mean square of those entries of disturbances (R,q2) that count, as `_rms`."""
    bound = problem.rows.model.bound
    squares = np.mean((disturbance / bound) ** 2, axis=0, where=counts)
    return float(np.sqrt(squares.mean()) * bound[0])


def _same(before: NoiseFit, after: NoiseFit, step: Array, std: Array) -> bool:
    enough = np.maximum(_SAME, _SAME_IN_STD * after.std)
    return bool(np.all(np.abs(after.logs - before.logs) < enough) and np.all(np.abs(step) < _SAME_IN_STD * std))
