"""What the residuals of a log say of the settings: their size, whether they are white, how many were refused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ndob_fmu.log.online import SURE_OF_NOISE, Stretch
from ndob_fmu.runtime.arrays import Array

LAGS = 20
# Twice the standard error is the band of a right setting. Long logs have narrow ones, in which nothing real lies: what
# is smaller than these is not worth a change.
_SIZE, _CORRELATED, _REFUSED = 1.3, 0.2, 0.01
_NOISE = 1.5
_ANY_FACTOR = 1000.0  # above it the number says nothing


@dataclass(frozen=True)
class OutputDiagnosis:
    """The residuals of one output.

    samples: how many are counted, from the end of the start on
    size: mean square of the residuals over their variance; 1 is right
    size_band: how far it may be from 1 by chance
    correlation (LAGS,): of residuals one sample apart, two, …; 0 is right
    correlation_band: how far they may be from 0 by chance
    refused: share of the samples that were refused
    noise_factor: the noise that the residuals show on average, over the noise_std that was told
    """

    samples: int
    size: float
    size_band: float
    correlation: Array
    correlation_band: float
    refused: float
    noise_factor: float

    def verdicts(self, output: str, noise_std: float, unit: str) -> Iterator[str]:
        """Yield what is wrong with a setting, and what to change, one line each; none where all is right.

        noise_std: that the observer used, which is above 0
        """
        if self.samples < LAGS:
            yield f"{output}: too few samples for a verdict ({self.samples} behind the start and not refused)"
            return
        if self.refused > _REFUSED:
            yield (
                f"{output}: {100.0 * self.refused:.1f} % of the samples were refused; look at them in result.csv for "
                "outliers and a sensor that sticks"
            )
        noise_is_wrong = not 1.0 / _NOISE < self.noise_factor < _NOISE or self._noise_explains_size
        # Noise does not follow itself: told a larger one, the observer would take the model's error for noise.
        if noise_is_wrong and not (self.noise_factor > 1.0 and self._follow_one_another):
            factor = max(self.noise_factor, 1.0 / self.noise_factor)
            size = "small" if self.noise_factor > 1.0 else "large"
            better = f"{noise_std * self.noise_factor:.2g} {unit}".rstrip()
            how = f"about {factor:.1f} ×" if factor < _ANY_FACTOR else "far"
            yield f"noise_std of {output} is {how} too {size}: the residuals show {better}"
        yield from self._of_disturbance(output)

    @property
    def _noise_explains_size(self) -> bool:
        """Whether residuals of a wrong size have it because the noise has another: within what is worth a change."""
        ratio = self.noise_factor**2
        too_small, too_large = ratio <= self.size * _SIZE, ratio * _SIZE >= self.size
        return (self._is_small and too_small) or (self._is_large and too_large)

    @property
    def _is_small(self) -> bool:
        return self.size < 1.0 / _SIZE - self.size_band

    @property
    def _is_large(self) -> bool:
        return self.size > _SIZE + self.size_band

    @property
    def _follow_one_another(self) -> bool:
        return follow_one_another(float(self.correlation[0]), self.samples)

    def _of_disturbance(self, output: str) -> Iterator[str]:
        if self._follow_one_another:
            yield (
                f"{output}: residuals follow one another (correlation {self.correlation[0]:.2f}); a parameter is wrong "
                "(`ndob-fmu fit --free`), the disturbance moves faster than disturbance_rate says, or the model lacks "
                "something"
            )
        elif self._noise_explains_size:
            return  # the verdict on the noise says what to change
        elif self._is_large:
            yield (
                f"{output}: residuals are {self.size**0.5:.1f} × as large as predicted; the disturbance is larger or "
                "faster than disturbance_bound and disturbance_rate say, or the model lacks something"
            )
        elif self._is_small:
            yield (
                f"{output}: residuals are {self.size**0.5:.2f} × as large as predicted; the disturbance is slower than "
                "disturbance_rate says: a lower rate gives a calmer estimate with a narrower band"
            )


def follow_one_another(correlation: float, samples: float) -> bool:
    """Return whether a correlation of so many residuals, one sample apart, is more than chance, and worth a change."""
    return correlation > max(_CORRELATED, _band(samples))


def _band(samples: float) -> float:
    return 2.0 / float(max(samples, 1.0) ** 0.5)


def products_apart(rows: Array, known: int, lags: int) -> tuple[Array, Array]:
    """Return how many pairs of rows (K,p) are 0, 1, … lags samples apart, and their sums of products (lags + 1,p).

    rows: NaN where nothing was measured
    known: so many of the first rows were counted before, and count only as partners of later ones
    """
    there = np.isfinite(rows)
    found = []
    for one in (there.astype(float), np.where(there, rows, 0.0)):
        starts = [max(known, lag) for lag in range(lags + 1)]
        pairs = [(one[first:], one[first - lag :][: len(one[first:])]) for lag, first in enumerate(starts)]
        found.append(np.array([np.einsum("kp,kp->p", late, early) for late, early in pairs]))
    return found[0], found[1]


class ResidualTally:
    """Sums over the residuals of a log, stretch by stretch."""

    def __init__(self, outputs: int, start_samples: int) -> None:
        self._start = start_samples
        self._rows = np.empty((0, outputs))
        self._counts, self._products = np.zeros((LAGS + 1, outputs)), np.zeros((LAGS + 1, outputs))
        self._measured, self._refused = np.zeros(outputs), np.zeros(outputs)
        self._unsure = start_samples + SURE_OF_NOISE
        self._latest, self._ratios, self._steps = np.ones(outputs), np.zeros(outputs), 0

    def add(self, stretch: Stretch) -> None:
        """Count a stretch; those before it must have been added."""
        said = stretch.online
        usable = np.where(said.refused > 0.0, np.nan, said.residual / said.residual_std)
        self._measured += np.isfinite(said.residual).sum(axis=0)
        self._refused += ((said.refused > 0.0) & np.isfinite(said.residual)).sum(axis=0)
        sure = said.noise_ratio[self._unsure :]
        self._unsure -= len(usable) - len(sure)
        self._latest = said.noise_ratio[-1]
        self._ratios += sure.sum(axis=0)
        self._steps += len(sure)
        left_out = min(self._start, len(usable))
        self._start -= left_out
        usable[:left_out] = np.nan
        known = len(self._rows)
        rows = np.concatenate([self._rows, usable])
        self._rows = rows[-LAGS:]
        counts, products = products_apart(rows, known, LAGS)
        self._counts += counts
        self._products += products

    def diagnoses(self) -> Sequence[OutputDiagnosis]:
        """Return the diagnosis of each output."""
        mean = self._products / np.maximum(self._counts, 1.0)
        ratio = self._ratios / self._steps if self._steps else self._latest
        return [
            OutputDiagnosis(
                samples=int(count),
                size=float(mean[0, i]),
                size_band=2.0 * (2.0 / max(count, 1.0)) ** 0.5,
                correlation=mean[1:, i] / mean[0, i] if mean[0, i] > 0.0 else np.zeros(LAGS),
                correlation_band=_band(count),
                refused=float(self._refused[i] / max(self._measured[i], 1.0)),
                noise_factor=float(ratio[i] ** 0.5),
            )
            for i, count in enumerate(self._counts[0].tolist())
        ]
