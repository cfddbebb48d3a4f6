"""Intensities for every step and noise, by a power law from those tuned for one of each.

An observer that follows disturbances up to the bandwidth ω leaves a bias of the size D ω^{-k} of a k-th derivative D,
k = max(r, 1). Noise of standard deviation σ in samples a step H apart gives d̂ the standard deviation
σ √H ω^{ρ+1/2} / g, where ρ is the relative degree of the disturbance in the outputs and g the gain of its first
response. Their sum is least where ω^{k+ρ+1/2} is proportional to D g / (σ √H). The intensity of that bandwidth is
s = σ² H ω^{2(r+ρ)} / g², so that

    s ∝ (σ² H)^κ,   κ = (2 (k − r) + 1) / (2 (k + ρ) + 1)

Near ω = 1/H the samples limit the bias, and a larger intensity changes next to nothing. An optimum there says nothing
about other noises: the intensities are tuned for a larger noise then, and brought back by the law. κ is measured there,
from two noises; with ρ anywhere between 0 and the relative degree, as other outputs may show d at the bandwidth first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import log

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.augmented import Augmented
from ndob_fmu.runtime.design.tuning import (
    SCAN,
    Knowledge,
    Search,
    at_bandwidth,
    fastest_bandwidth,
    from_pi,
    predicted_errors,
    response_to_d,
    search,
)

# The bandwidth over 1/H up to which the power law holds.
_RESOLVED = 0.5
# The ratio of the two noises from which the exponent is measured.
_APART = 10.0


@dataclass(frozen=True)
class IntensityLaw:
    """s = disturbance · (ν² H / H₁)^exponent, at most limit · ν² (H / H₁)^limit_exponent, for ν times the noise told.

    disturbance (q_d,): s at the step H₁ and the noise told.
    limit (q_d,): the intensity there beyond which the gain no longer changes.
    H: H₁, in s.
    exponent, limit_exponent: of the law and of its limit.
    """

    disturbance: Array = field(repr=False)
    limit: Array = field(repr=False)
    H: float
    exponent: float
    limit_exponent: float

    def at(self, H: float, noise_scale: float = 1.0) -> Array:
        """Return the intensities (q_d,) for a step H (s) and `noise_scale` times the noise that was told."""
        noise, step = noise_scale**2, H / self.H
        law = self.disturbance * (noise * step) ** self.exponent
        return np.asarray(np.minimum(law, self.limit * (noise * step**self.limit_exponent)))

    def scaled(self, tuned: Array, tuned_at: float, H: float, noise: Sequence[float]) -> Array:
        """Return intensities (q_d,) for a step H (s) from those `tuned` for a step `tuned_at` (s) and the noise told.

        noise (p,): factors on the variances of the samples; their geometric mean counts
        """
        variance = float(np.exp(np.mean(np.log(noise))))
        return np.asarray(tuned * self.at(H, float(np.sqrt(variance))) / self.at(tuned_at))


def tuned_law(system: Augmented, H: float, alpha: float, known: Knowledge, found: Search | None = None) -> IntensityLaw:
    """Return the law of the intensities that minimise J, tuned at the step H (s) or at a larger noise.

    found: what `search` returns, where the caller has it

    Raises DesignError where an unknown input shows in no output.
    """
    degree, gain = response_to_d(system, known.R_factor)
    r, k = system.order, max(system.order, 1)
    steepness = k + degree + 0.5
    expected = (k * known.disturbance_rate[0] * gain / ((degree + 0.5) * H**0.5)) ** (1.0 / steepness)
    noise_scale = max(1.0, float(expected * H / _RESOLVED) ** steepness)
    errors = predicted_errors(system, H, alpha, known)
    bandwidth, tried = search(system, H, alpha, known) if found is None else found
    if noise_scale != 1.0:
        # The first bandwidths of a search are the same for every noise.
        bandwidth, tried = errors.best_bandwidth(noise_scale, tried[:SCAN])
    slower, _ = errors.best_bandwidth(noise_scale * _APART, tried)
    measured = 1.0 - (r + degree) * log(bandwidth / slower) / log(_APART)
    exponent = min(max(measured, (k - r + 0.5) / steepness), (k - r + 0.5) / (k + 0.5))
    tuned = at_bandwidth(system, H, bandwidth, known).disturbance
    limit = at_bandwidth(system, H, fastest_bandwidth(system, H, known), known).disturbance
    return IntensityLaw(
        disturbance=tuned * noise_scale ** (2.0 - 2.0 * exponent),
        limit=limit,
        H=H,
        exponent=exponent,
        limit_exponent=1.0 - 2.0 * (r + degree),
    )


def law_from_pi(system: Augmented, H: float, pi: float, known: Knowledge) -> IntensityLaw:
    """Return the law of `from_pi`: the ratio of s to σ² H stays π."""
    intensities = from_pi(system, H, pi, known).disturbance
    return IntensityLaw(disturbance=intensities, limit=intensities, H=H, exponent=1.0, limit_exponent=1.0)
