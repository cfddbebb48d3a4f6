"""What a disturbance that jumps does between its jumps, and a pace with which the error bars hold that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ndob_fmu.log.fit.noise_fit import NoiseFit
from ndob_fmu.log.fit.problem import Linearised
from ndob_fmu.log.fit.rare import usual_std
from ndob_fmu.log.smooth.events import with_events
from ndob_fmu.log.smooth.linear_record import Smoothed
from ndob_fmu.runtime.arrays import Array

# Error bars hold where nine of ten errors are within two of them: those of a normal number are within 1.64 standard
# deviations.
_OF_STD = 1.64 / 2.0
# They are raised until they are within this factor of what is needed.
_HOLDS, _MOST_RAISES = 0.95, 8
# By what power of a factor on the intensity the variance of d̂ grows, about.
_POWER = 0.75
# What wanders by more than this part of a jump is jumps that were too small to be found. A jump is seen in full so many
# rows beside it.
_SMALL, _BESIDE = 0.25, 2


def raised(known: Linearised, noise: NoiseFit) -> Array:
    """Return the factors on the intensities (q2,) with which the error bars hold what wanders between jumps.

    A disturbance that jumps stays where it is in between. What wanders there is what the model lacks, as a friction
    that changes along the way. Samples tell it well, but it is an error of the disturbance from outside, beside that of
    the estimate.
    """
    problem, places = known.problem, known.problem.layout.disturbance
    factors, needed = np.ones(len(noise.log_intensity)), np.zeros(len(noise.log_intensity))
    for turn in range(_MOST_RAISES):
        told = replace(noise, log_intensity=noise.log_intensity + np.log(factors))
        found = with_events(known.whole(told), known.columns, noise.events)
        change, variance = Smoothed(found.forward, found.adjoint).some(places)
        if turn == 0:
            smooth, jumps = known.trajectory[:, places] + change, sorted(found.events.jumps)
            needed = _OF_STD * np.minimum(
                _wanders(smooth, problem.rows.model.start_samples, jumps),
                _SMALL * np.median(jump_sizes(smooth, jumps), axis=0),
            )
        std = np.sqrt(np.median(variance, axis=0))
        if np.all(std >= _HOLDS * needed):
            break
        factors = np.maximum(factors * (needed / std) ** (2.0 / _POWER), factors)
    return factors


def jump_sizes(disturbance: Array, jumps: Sequence[int]) -> Array:
    """Return the sizes (·,q2) of jumps of smoothed disturbances (K,q2)."""
    after, before = (np.clip(np.array(jumps) + side * _BESIDE, 0, len(disturbance) - 1) for side in (1, -1))
    return np.asarray(np.abs(disturbance[after] - disturbance[before]))


def _wanders(disturbance: Array, first: int, jumps: Sequence[int]) -> Array:
    """Return the standard deviation (q2,) of disturbances (K,q2) about their means between jumps, by the median.

    A jump that is too small to be found would count in a root mean square.
    """
    parts = np.split(disturbance[first:], [k - first for k in jumps if k > first])
    about_means = np.concatenate([part - part.mean(axis=0) for part in parts if len(part)])
    return usual_std(about_means)
