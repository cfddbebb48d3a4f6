"""Faults of the samples: each takes a record and returns it with other samples, the same for the same seeds.

The controller of the plant has read the good samples.
"""

from __future__ import annotations

import numpy as np

from benchmarks.estimator.plants import Array
from benchmarks.estimator.records import Record


def outliers(record: Record, size: float, share: float = 0.02) -> Record:
    """Move this share of the first output's samples by ± `size` standard deviations of its noise."""
    Y = record.Y.copy()
    for samples, random in zip(Y, _generators(record, 2), strict=True):
        hit = random.random(len(samples)) < share
        samples[hit, 0] += size * record.plant.sigma[0] * random.choice([-1.0, 1.0], int(hit.sum()))
    return record.with_samples(Y)


def repeated(record: Record, share: float = 0.05) -> Record:
    """Repeat the sample before, as sensor or bus delivered it once more, in this share of the samples."""
    Y = record.Y.copy()
    for samples, random in zip(Y, _generators(record, 3), strict=True):
        for k in range(1, len(samples)):
            if random.random() < share:
                samples[k] = samples[k - 1]
    return record.with_samples(Y)


def stuck(record: Record, count: int = 12, at: float = 0.55) -> Record:
    """Repeat one sample `count` − 1 times, from this share of the record on."""
    Y = record.Y.copy()
    first = int(at * Y.shape[1])
    Y[:, first : first + count] = Y[:, first : first + 1]
    return record.with_samples(Y)


def quantised(record: Record, size: float = 20.0) -> Record:
    """Round every sample to multiples of `size` standard deviations of the noise."""
    width = size * record.plant.sigma
    return record.with_samples(np.round(record.Y / width) * width)


def lost(record: Record, share: float) -> Record:
    """Lose this share of the samples, with all their entries."""
    Y = record.Y.copy()
    for samples, random in zip(Y, _generators(record, 6), strict=True):
        samples[random.random(len(samples)) < share] = np.nan
    return record.with_samples(Y)


def every_tenth(record: Record, output: int) -> Record:
    """Keep every tenth sample of an output, NaN in the others."""
    Y = record.Y.copy()
    Y[:, np.arange(Y.shape[1]) % 10 != 0, output] = np.nan
    return record.with_samples(Y)


def jittering(H: float, stop_time: float, seed: int, share: float = 0.3) -> Array:
    """Return steps (K,) that differ from H (s) by up to this share."""
    count = round(stop_time / H)
    return np.asarray(H * (1.0 + share * np.random.default_rng([seed, 4]).uniform(-1.0, 1.0, count)))


def _generators(record: Record, stream: int) -> list[np.random.Generator]:
    return [np.random.default_rng([seed, stream]) for seed in record.seeds]
