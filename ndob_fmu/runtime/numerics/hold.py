"""The measurement between samples: a polynomial through the latest samples, continued into the step.

Holding the last sample is useless here: at π = 1e12 the estimate is 1e6 times an output error, and a held output is
wrong by its rate times the step. A polynomial of degree k is wrong by O(H^{k+1}).

A polynomial through samples that lie close together, as around a very short step, must not be continued over a long
step: rounding errors grow with the square of the ratio. So more samples are kept than a polynomial needs, and each step
chooses its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.runtime.arrays import Array

# The samples of a polynomial lie at least this part of the step apart over which it is continued.
_LEAST_SPACING = 0.1


@dataclass(frozen=True)
class History:
    """Past samples, newest first.

    ages (k,): in s, 0 for a sample taken now.
    samples (k,p): the measurements.
    """

    ages: Array = field(metadata={"grows": True})
    samples: Array = field(metadata={"grows": True})

    def possible(self, degree: int) -> bool:
        """Return whether these can be samples for polynomials of at most this degree."""
        ages, samples = self.ages, self.samples
        finite = bool(np.all(np.isfinite(ages)) and np.all(np.isfinite(samples)))
        in_order = bool(np.all(ages >= 0.0) and np.all(np.diff(ages) >= 0.0))
        return finite and in_order and len(ages) == len(samples) <= 2 * (degree + 1)

    def with_sample(self, y: Array, degree: int) -> History:
        """Return the history after a sample y (p,) taken now, of at most 2 (degree + 1) samples.

        The newest degree + 1 stay. Of the others the one is dropped whose distance to the next newer one is smallest
        relative to its age.
        """
        ages, samples = np.concatenate([[0.0], self.ages]), np.vstack([y, self.samples])
        if len(ages) > 2 * (degree + 1):
            distances = np.diff(ages)[degree:] / ages[degree + 1 :]
            closest = len(ages) - 1 - int(np.argmin(distances[::-1]))
            ages, samples = np.delete(ages, closest), np.delete(samples, closest, axis=0)
        return History(ages=ages, samples=samples)

    def chosen(self, H: float, degree: int) -> History:
        """Return the newest samples, at most degree + 1, that are far enough apart to be continued over H (s)."""
        ages = self.ages.tolist()
        indices = [0]
        for index in range(1, len(ages)):
            if len(indices) > degree:
                break
            if ages[index] - ages[indices[-1]] >= _LEAST_SPACING * H:
                indices.append(index)
        return History(ages=self.ages[indices], samples=self.samples[indices])

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
