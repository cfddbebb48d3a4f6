"""A step of the plant's parameters: towards the most likely ones, or towards those that leave the least disturbance.

The most likely ones are right where the model has no other fault. Where it lacks something else, they are those that
explain the fast part of it, which the class of the disturbance says is unlikely; then the disturbance that is left may
be larger than with the parameters as told. Those that leave the least disturbance weigh all of it alike, but for
pulses.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from ndob_fmu.log.fit.error_bars import widened
from ndob_fmu.log.fit.likelihood import Likelihood, Moved, likelihood
from ndob_fmu.log.fit.needed_events import needed_events
from ndob_fmu.log.fit.noise_fit import UNKNOWN, NoiseFit, moved
from ndob_fmu.log.fit.problem import Problem
from ndob_fmu.log.fit.rare import weights_of_usual
from ndob_fmu.log.smooth.along import Course
from ndob_fmu.log.smooth.events import Events
from ndob_fmu.log.smooth.linear_record import Smoothed
from ndob_fmu.log.smooth.smoother import backward, forward
from ndob_fmu.runtime.arrays import Array

# Differences are taken over this part of a parameter's prior standard deviation.
_MOVED = 1e-3
# Parameters within so many standard deviations are near, and by how many halvings the least ones there are found.
_NEAR, _HALVINGS = 2.0, 60


class Step(NamedTuple):
    """A step (n_θ,) of the parameters, their covariance (n_θ,n_θ), and the events that are needed beside it."""

    step: Array
    covariance: Array
    events: Events


def most_likely(problem: Problem, trajectory: Array, theta: Array, noise: NoiseFit) -> Step:
    """Return the step of Fisher's scoring to the most likely parameters.

    noise: the most likely one at θ

    Noise and pace change with θ, as the force behind an acceleration does with the mass. So the information is that
    about all of them.

    So does the trajectory: what θ adds to ẋ, the smoothed disturbance takes away. If it stayed, the slopes of the
    equations by x would change with θ wherever those by d or θ depend on x, although ẋ does not. The smoothed state
    knows later samples. So that change would be like the innovations, and its sum along the record a bias of θ.
    """
    K, prior, n = problem.trained, problem.parameter_std, len(problem.parameter_std)
    course = problem.course(trajectory[:K], theta)

    def about(step: Array, at: Array) -> Moved:
        cut, search = problem.about(problem.course(at, theta + step), course.plan).pieces(slice(K))
        return Moved(noise.cut(cut, problem.layout), search.columns, float(step.sum()))

    def told(step: Array) -> Moved:
        """Return the record with θ moved, about the trajectory that is smoothed with it."""
        there = about(step, trajectory[:K])
        if problem.rows.model.equations.surfaces is not None:
            return there  # a state that moves may cross a kink, where slopes by differences are of no use
        at = trajectory[:K].copy()
        at[: len(here)] += _smoothed(there, noise.events) - here
        return about(step, at)

    record, search = problem.about(course, course.plan).pieces(slice(K))
    centre, of_noise = moved(record, problem.layout, search.columns, noise.logs)
    here = _smoothed(centre, noise.events)
    of_parameters = [*map(told, np.diag(_MOVED * prior))]
    of_prior = np.concatenate([prior**-2.0, np.full(len(of_noise), UNKNOWN**-2)])
    prior_slopes = -(theta - problem.told) / prior**2

    by_parameters = partial(likelihood, centre, of_parameters)
    first, precision = record.pieces.own[:-1], np.diag(of_prior[:n])
    events = needed_events(noise.events, by_parameters, first, prior_slopes, precision)
    found = likelihood(centre, [*of_parameters, *of_noise], events)
    slopes = found.slopes
    slopes[:n] += prior_slopes
    inverse = np.asarray(np.linalg.inv(found.information + np.diag(of_prior)))
    bars = widened(inverse, inverse, found.answer, found.surprise)
    step = np.asarray(np.linalg.solve(_apart(found, n) + np.diag(of_prior), slopes))
    return Step(step[:n], bars[:n, :n], events)


def _smoothed(told: Moved, events: Events) -> Array:
    """Return ξ (R,N) of the rows of all pieces, about the trajectory."""
    run = told.filtered(events)
    return told.record.pieces.joined(Smoothed(run, backward(told.with_events(events), run)).xi)


def _apart(found: Likelihood, n: int) -> Array:
    """Return the information of n parameters and of the noise, without what their innovations have in common.

    In the mean that is nothing. Where the parameters are wrong, what they leave in the innovations is in both.
    """
    information, p = found.information, found.answer.shape[1] // 2
    by_variance = np.einsum("acr,bcr->ab", found.answer[:n, p:], found.answer[n:, p:])
    information[:n, n:], information[n:, :n] = by_variance, by_variance.T
    return information


def least_disturbance(problem: Problem, trajectory: Array, theta: Array, noise: NoiseFit) -> Step:
    """Return a step to the least mean square of the smoothed disturbance, without what is rare, as pulses.

    The covariance counts what the disturbance is along each piece, not each row, as one observation of its own.
    """
    d, slopes = _disturbance(problem, trajectory, theta, noise)

    def left_with(some: Array) -> Array:
        root = np.sqrt(some).reshape(*d.shape[:2], -1)
        step, _ = _to_the_least(problem, root * d, root * slopes)
        return np.asarray((d + np.einsum("alsq,a->lsq", slopes, step)).reshape(-1, d.shape[-1]))

    root = np.sqrt(weights_of_usual(left_with, d.shape[0] * d.shape[1])).reshape(d.shape)
    d, slopes = root * d, root * slopes
    step, inverse = _to_the_least(problem, d, slopes)
    left = d + np.einsum("alsq,a->lsq", slopes, step)
    of_pieces = np.einsum("alsq,lsq->sa", slopes, left)
    covariance = inverse @ (of_pieces.T @ of_pieces) @ inverse
    return Step(step, widened(covariance, inverse, _in_time(slopes), _in_time(left)), noise.events)


def least_near(problem: Problem, trajectory: Array, theta: Array, noise: NoiseFit, covariance: Array) -> Array:
    """Return the parameters (n_θ,) near θ that leave the least mean square of the smoothed disturbance, about.

    covariance (n_θ,n_θ): of θ

    The least one within a ball is that with a weight on the distance from θ (Moré and Sorensen, 1983).
    """
    d, slopes = _disturbance(problem, trajectory, theta, noise)
    std = np.linalg.cholesky(covariance)
    normal, turned = np.linalg.eigh(std.T @ np.einsum("alsq,blsq->ab", slopes, slopes) @ std)
    slope = turned.T @ std.T @ np.einsum("alsq,lsq->a", slopes, d)
    low, high = 0.0, float(np.linalg.norm(slope)) / _NEAR
    for _ in range(_HALVINGS):
        weight = 0.5 * (low + high)
        far = float(np.linalg.norm(slope / np.maximum(normal + weight, 1e-300)))
        low, high = (weight, high) if far > _NEAR else (low, weight)
    return np.asarray(theta - std @ turned @ (slope / np.maximum(normal + high, 1e-300)))


def _disturbance(problem: Problem, trajectory: Array, theta: Array, noise: NoiseFit) -> tuple[Array, Array]:
    """Return the smoothed disturbance (L,S,q2) of the pieces, over its bound, and its slopes by θ (n_θ,L,S,q2).

    Differences are one-sided: the disturbance is nearly linear in θ.
    """
    K, layout, model = problem.trained, problem.layout, problem.rows.model
    centre = problem.course(trajectory[:K], theta)

    def disturbance(course: Course) -> Array:
        record, search = problem.about(course, centre.plan).pieces(slice(K))
        told = noise.cut(record, layout)
        run = forward(told.parts, told.pieces.placed(search.columns.at(noise.events.jumps)))
        xi = trajectory[told.pieces.rows] + Smoothed(run, backward(told.parts, run)).xi
        return np.asarray((xi[..., layout.disturbance] - model.settings.disturbance_nominal) / model.bound)

    d, slopes = disturbance(centre), []
    for step in np.diag(_MOVED * problem.parameter_std):
        beside = problem.course(centre.trajectory, theta + step)
        slopes.append((disturbance(beside) - d) / step.sum())
    return d, np.array(slopes)


def _to_the_least(problem: Problem, d: Array, slopes: Array) -> tuple[Array, Array]:
    """Return the step (n_θ,) to the least mean square of d, and the inverse (n_θ,n_θ) of its normal equations."""
    prior = problem.parameter_std
    normal = np.einsum("alsq,blsq->ab", slopes, slopes)
    inverse = np.linalg.pinv(normal * prior * prior[:, None], rcond=1e-10, hermitian=True) * prior * prior[:, None]
    return -inverse @ np.einsum("alsq,lsq->a", slopes, d), inverse


def _in_time(pieces: Array) -> Array:
    """Return numbers (…,L,S,q2) of pieces as (…,q2,R), one piece after the other."""
    turned = np.moveaxis(pieces, -3, -1)
    return np.swapaxes(turned, -3, -2).reshape(*pieces.shape[:-3], pieces.shape[-1], -1)
