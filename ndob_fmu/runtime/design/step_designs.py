"""The designs of one observer: one for each step size that it meets, each made once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.augmented import Augmented
from ndob_fmu.runtime.design.intensity_law import IntensityLaw, law_from_pi, tuned_law
from ndob_fmu.runtime.design.stationary_design import Intensities, StationaryDesign, stationary_design
from ndob_fmu.runtime.design.tuning import (
    Knowledge,
    Search,
    from_pi,
    search,
    steady_residual_std,
    steady_std,
    tuned_intensities,
)
from ndob_fmu.runtime.memo import LatestResult, SharedResults, by_value

# A thousand instances of the same parameters need one design.
_INTENSITIES: SharedResults[Intensities] = SharedResults(64)
_DESIGNS: SharedResults[StationaryDesign] = SharedResults(16)
_SEARCHES: SharedResults[Search] = SharedResults(16)
_LAWS: SharedResults[IntensityLaw] = SharedResults(64)
# The covariance of states whose sums are measured keeps no digit of a noise that is smaller than this part of theirs.
_LEAST_NOISE = 1e-10


@dataclass(frozen=True)
class StepDesign:
    """The stationary design for a step size, and what follows from it for the class of disturbances that is known."""

    stationary: StationaryDesign
    known: Knowledge

    @property
    def H(self) -> float:
        """The step size (s)."""
        return self.stationary.discrete.H

    @cached_property
    def source_bound(self) -> Array:
        """Bound (q2,) of what drives the disturbance in the model: of d^{(r)}, of d itself for r = 0."""
        return self.known.disturbance_rate if self.stationary.system.order else self.known.disturbance_bound

    @cached_property
    def disturbance_std(self) -> Array:
        """The error bar (q2,) of d̂ a step ahead, once the gain has converged."""
        return steady_std(self.stationary, self.known.disturbance_rate)

    @cached_property
    def judged(self) -> Array:
        """Rows (p,N) of what tells whether the gain has converged: the outputs, and for r ≥ 1 the disturbances."""
        system = self.stationary.system
        return system.C if system.selector is None else np.vstack([system.C, system.selector])

    @cached_property
    def judged_variances(self) -> Array:
        """Their variances once it has."""
        return squared_norms(self.judged @ self.stationary.prior_factor)

    @cached_property
    def residual_std(self) -> Array:
        """The standard deviation (p,) of residuals once the gain has converged."""
        return steady_residual_std(self.stationary, self.source_bound)


@dataclass(frozen=True)
class StepDesigns:
    """Finds the design for a step size.

    x_std (n,): standard deviations of x̂₀'s error. pi: sets the pace where `known` has no rate of the disturbance (0).
    """

    system: Augmented
    known: Knowledge
    x_std: Array
    alpha: float
    pi: float
    _latest: LatestResult[StepDesign] = field(default_factory=LatestResult, repr=False, compare=False)
    _latest_intensities: LatestResult[Intensities] = field(default_factory=LatestResult, repr=False, compare=False)

    def at(
        self,
        H: float,
        tuned_at: float | None = None,
        noise: tuple[float, ...] | None = None,
        tuned: Intensities | None = None,
    ) -> StepDesign:
        """Return the design for a step H (s), with the intensities tuned for a step `tuned_at` (s) near it, H if None.

        noise: factors (p,) on the variances of the samples; None for the noise that was told
        tuned: those intensities, if the caller has them

        Raises DesignError where there is none.
        """
        tuned_for, told = H if tuned_at is None else tuned_at, (1.0,) * len(self.known.R_factor)
        factors = told if noise is None else noise

        def stationary() -> StationaryDesign:
            R_factor, intensities = self.known.R_factor, self.intensities(tuned_for) if tuned is None else tuned
            if factors != told:
                R_factor = R_factor * np.sqrt(factors)
                changed = self.law(tuned_for).scaled(intensities.disturbance, tuned_for, H, factors)
                intensities = replace(intensities, disturbance=changed)
            return stationary_design(self.system, H, R_factor, intensities, self.alpha)

        def design() -> StepDesign:
            # Noise that was found is hardly ever the same in two instances, and is not worth memory.
            found = _DESIGNS((H, tuned_for, self._key), stationary) if factors == told else stationary()
            return StepDesign(found, self.known)

        return self._latest((H, tuned_for, *factors), design)

    def searched(self, H: float) -> Search | None:
        """Return the search for the bandwidth at a step H (s), on which intensities and their law stand; None with π.

        Raises DesignError where no bandwidth has a design.
        """
        if not np.all(self.known.disturbance_rate > 0.0):
            return None
        return _SEARCHES((H, self._key), lambda: search(self.system, H, self.alpha, self.known))

    def intensities(self, H: float, searched: Search | None = None) -> Intensities:
        """Return the noise intensities tuned for a step H (s).

        searched: what the method of this name returns, where the caller has it
        """
        return self._latest_intensities((H,), lambda: _INTENSITIES((H, self._key), lambda: self._tuned(H, searched)))

    def law(self, H: float, searched: Search | None = None) -> IntensityLaw:
        """Return the law of the intensities for other steps and noises, tuned at a step H (s).

        searched: as in `intensities`
        """

        def found() -> IntensityLaw:
            if np.all(self.known.disturbance_rate > 0.0):
                return tuned_law(self.system, H, self.alpha, self.known, searched)
            return law_from_pi(self.system, H, self.pi, self.known)

        return _LAWS((H, self._key), found)

    def _tuned(self, H: float, searched: Search | None) -> Intensities:
        if np.all(self.known.disturbance_rate > 0.0):
            found = tuned_intensities(self.system, H, self.alpha, self.known, searched)
        else:
            found = from_pi(self.system, H, self.pi, self.known)
        largest = np.abs(self.system.linear.C) @ self.x_std
        scale = float(np.max(_LEAST_NOISE * largest / np.diag(self.known.R_factor)))
        return replace(found, scale=max(found.scale, scale))

    @cached_property
    def _key(self) -> tuple[object, ...]:
        """All that intensities and stationary designs depend on besides the step."""
        key: tuple[object, ...] = by_value((self.system, self.known, self.x_std, self.alpha, self.pi))
        return key


def squared_norms(rows: Array) -> Array:
    """Return the squared norms (k,) of rows (k,·): variances, where these are of a factor of a covariance."""
    return np.asarray(np.sum(rows * rows, axis=1))
