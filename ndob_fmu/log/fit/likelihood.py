"""The likelihood of a record for the noise of its samples and the pace of its disturbance, and its slopes.

The record is taken in pieces that begin with a wide covariance, so that their likelihoods add up. The adjoint of each
piece gives the slopes (`smoother`): with R of a sample and a column g of a step's noise,

    ∂L/∂log R = ½ R (u² − D),    ∂L/∂log q = ½ (gᵀλ)² − ½ gᵀΛg
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ndob_fmu.log.events import Events, Jumps, with_outliers
from ndob_fmu.log.pieces import CutRecord
from ndob_fmu.log.smoother import LinearRecord
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.layout import Layout


@dataclass(frozen=True)
class Likelihood:
    """L and its slopes.

    value: L
    by_log_variance (p,): for a factor on the variances of an output's samples
    by_log_intensity (q2,): for a factor on the intensity of what drives a disturbance
    """

    value: float
    by_log_variance: Array
    by_log_intensity: Array

    @property
    def slopes(self) -> Array:
        """Both slopes (p + q2,)."""
        return np.concatenate([self.by_log_variance, self.by_log_intensity])


def scaled(record: LinearRecord, layout: Layout, variance: Array, intensity: Array) -> LinearRecord:
    """Return a record with factors on the variances (p,) of samples and on the intensities (q2,)."""
    noise = record.noise.copy()
    _by_direction(noise, layout)[..., : layout.q, :] *= np.sqrt(intensity)[:, None]
    return replace(record, noise=noise, variance=record.variance * variance)


def likelihood(record: CutRecord, layout: Layout, columns: Jumps, events: Events) -> Likelihood:
    """Return the likelihood of a record with events; columns: J of jumps."""
    told, run, adjoint = record.passes_of_pieces(with_outliers(record.whole.variance, events), columns.at(events.jumps))
    of_disturbance = _by_direction(told.noise, layout)[..., : layout.q, :]
    g = np.moveaxis(of_disturbance, -3, -1)  # (K - 1,S,q2,N,N): columns in rows
    of_state, of_variance = adjoint.of_state[1:, :, None], adjoint.of_state_variance[1:, :, None]
    first = np.matmul(g, of_state[..., None])[..., 0] ** 2
    second = np.sum(np.matmul(g, of_variance) * g, axis=-1)
    by_sample = told.variance * (adjoint.of_sample**2 - adjoint.of_sample_variance)
    return Likelihood(
        value=float(run.log_likelihoods.sum()),
        by_log_variance=0.5 * by_sample.sum(axis=(0, 1)),
        by_log_intensity=0.5 * (first - second).sum(axis=(0, 1, 3)),
    )


def _by_direction(noise: Array, layout: Layout) -> Array:
    """Return a view (…,·,directions,N) of the factors of noise: the columns of each direction."""
    return noise.reshape(*noise.shape[:-1], -1, layout.size)
