"""The measurement between samples: a polynomial through the latest samples, continued into the step.

Holding the last sample is useless here: at π = 1e12 the estimate is 1e6 times an output error, and a held output is
wrong by its rate times the step. A polynomial of degree k is wrong by O(H^{k+1}).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.riccati import Array


@dataclass(frozen=True)
class History:
    """The latest samples, newest first. ages (k,) in s, 0 for a sample taken now; samples (k,p)."""

    ages: Array
    samples: Array

    def with_sample(self, y: Array, degree: int) -> History:
        """Return the history after a sample y (p,) taken now, of at most degree + 1 samples."""
        return History(
            ages=np.concatenate([[0.0], self.ages])[: degree + 1],
            samples=np.vstack([y, self.samples])[: degree + 1],
        )

    def aged(self, H: float) -> History:
        """Return the history as seen H seconds later."""
        return History(ages=self.ages + H, samples=self.samples)

    def at(self, s: float) -> Array:
        """Return the polynomial's value (p,) s seconds from now, by Lagrange's formula."""
        ages = self.ages.tolist()
        weights = []
        for j, own in enumerate(ages):
            weight = 1.0
            for i, other in enumerate(ages):
                if i != j:
                    weight *= (s + other) / (other - own)
            weights.append(weight)
        return np.asarray(weights @ self.samples)


def empty_history(p: int) -> History:
    """Return the history of p outputs before the first sample."""
    return History(ages=np.empty(0), samples=np.empty((0, p)))
