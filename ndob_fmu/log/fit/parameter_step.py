"""A step of the plant's parameters: towards the most likely ones, or towards those that leave the least disturbance.

The most likely ones are right where the model has no other fault. Where it lacks something else, they are those that
explain the fast part of it, which the class of the disturbance says is unlikely; then the disturbance that is left may
be larger than with the parameters as told. Those that leave the least disturbance weigh all of it alike.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

from ndob_fmu.log.fit.likelihood import Likelihood, likelihood
from ndob_fmu.log.fit.noise_fit import NoiseFit
from ndob_fmu.log.fit.problem import Problem
from ndob_fmu.log.smoother import backward, forward, smoothed
from ndob_fmu.runtime.arrays import Array

# Differences are taken over this part of a parameter's standard deviation, which is found from a first, small one.
_OVER = 0.5
_FIRST = 1e-3


def most_likely(problem: Problem, trajectory: Array, theta: Array, noise: NoiseFit) -> tuple[Array, Array]:
    """Return Newton's step (n_θ,) to the most likely parameters, and their covariance (n_θ,n_θ).

    noise: the most likely one at θ

    Noise and pace change with θ, as the force behind an acceleration does with the mass. So the curvature is that of
    the likelihood at the best noise and pace for each θ.
    """
    K, prior = problem.trained, problem.parameter_std
    events, told = noise.events, problem.told

    def at(moved: Array) -> Likelihood:
        record, search = problem.about(trajectory[:K], theta + moved).pieces(slice(K))
        return likelihood(noise.cut(record, problem.layout), problem.layout, search.columns, events)

    centre = at(np.zeros(len(prior)))
    over = _spans(at, centre.value, prior)
    steps = np.diag(over)
    up, down = [at(step) for step in steps], [at(-step) for step in steps]
    slope = np.array([a.value - b.value for a, b in zip(up, down, strict=True)]) / (2.0 * over)
    of_noise = np.array([a.slopes - b.slopes for a, b in zip(up, down, strict=True)]) / (2.0 * over)[:, None]
    curvature = np.diag([a.value + b.value - 2.0 * centre.value for a, b in zip(up, down, strict=True)] / over**2)
    for i, j in combinations(range(len(prior)), 2):
        both = at(steps[i] + steps[j]).value - up[i].value - up[j].value + centre.value
        curvature[i, j] = curvature[j, i] = both / (over[i] * over[j])
    covariance = _inverse(np.diag(prior**-2.0) - curvature - of_noise @ noise.covariance @ of_noise.T, prior)
    return covariance @ (slope - (theta - told) / prior**2), covariance


def _spans(at: Callable[[Array], Likelihood], centre: float, prior: Array) -> Array:
    """Return spans (n_θ,) over which the likelihood changes by enough to tell its curvature."""
    spans = []
    for step in np.diag(_FIRST * prior):
        curvature = abs(2.0 * centre - at(step).value - at(-step).value) / step.sum() ** 2
        spans.append(min(_OVER / max(curvature**0.5, 1e-300), 0.1 * float(prior[step > 0.0][0])))
    return np.array(spans)


def _inverse(precision: Array, prior: Array) -> Array:
    """Return the inverse of a precision (n_θ,n_θ), which is that of the prior in directions where it is less."""
    sizes, axes = np.linalg.eigh(precision * prior * prior[:, None])
    return np.asarray((axes / np.maximum(sizes, 1.0)) @ axes.T * prior * prior[:, None])


def least_disturbance(problem: Problem, trajectory: Array, theta: Array, noise: NoiseFit) -> tuple[Array, Array]:
    """Return a step (n_θ,) to the least mean square of the smoothed disturbance, and its covariance (n_θ,n_θ).

    The covariance counts what the disturbance is along each piece, not each row, as one observation of its own.
    """
    K, layout, model = problem.trained, problem.layout, problem.rows.model

    def disturbance(moved: Array) -> Array:
        record, search = problem.about(trajectory[:K], theta + moved).pieces(slice(K))
        told = noise.cut(record, layout)
        run = forward(told.parts, told.pieces.placed(search.columns.at(noise.events.jumps)))
        xi = trajectory[told.pieces.rows] + smoothed(run, backward(told.parts, run)).xi
        return np.asarray((xi[..., layout.disturbance] - model.settings.disturbance_nominal) / model.bound)

    prior = problem.parameter_std
    d = disturbance(np.zeros(len(prior)))
    steps = np.diag(_FIRST * prior)
    slopes = np.array([(disturbance(step) - disturbance(-step)) / (2.0 * step.sum()) for step in steps])
    normal = np.einsum("alsq,blsq->ab", slopes, slopes)
    of_pieces = np.einsum("alsq,lsq->sa", slopes, d)
    inverse = np.linalg.pinv(normal * prior * prior[:, None], rcond=1e-10, hermitian=True) * prior * prior[:, None]
    step = -inverse @ of_pieces.sum(axis=0)
    left = of_pieces + np.einsum("alsq,blsq,b->sa", slopes, slopes, step)
    return step, inverse @ (left.T @ left) @ inverse
