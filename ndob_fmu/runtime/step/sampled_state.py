"""What the sampled-data observer remembers, and what its steps have in common once the gain is frozen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector

Numbers: TypeAlias = tuple[float, ...]


@dataclass(frozen=True)
class Confidence:
    """How good ξ̂⁻ is, and how it came to be so.

    factor (N,N): of its covariance; d_std (q2,): error bar of d̂; at_rest: whether the gain is frozen; tuned_at: the
    step (s) that the intensities were tuned for, 0 before the first one; waited: time (s) of the short steps since the
    last sample that was used; refused: samples refused in a row; age: steps since the start, as far as they count.
    """

    factor: Array
    d_std: Numbers
    at_rest: bool
    tuned_at: float
    waited: float
    refused: int
    age: int


@dataclass(slots=True)  # never changed once made; frozen=True would make that cost a tenth of a step
class SampledState:
    """All that the observer remembers, as of just before the next sample.

    xi_hat (n + 3 q2,): ξ̂⁻, and zeros for the derivatives of d̂ beyond the order r; d_hat (q2,); u (m,): the last finite
    input; deviation (p,): how far the last sample lay from its prediction, with its sign, or could have lain where it
    was not used.
    """

    xi_hat: Numbers
    d_hat: Numbers
    u: Numbers
    deviation: Numbers
    confidence: Confidence


@dataclass(frozen=True)
class StepAtRest:
    """What all steps of one length H (s) have in common once the gain is frozen.

    observer_step is that of `equations.Steps`, constants and frozen are its k and r. M_H (q2,p): None but for r = 0.
    confidence: at rest.
    """

    H: float
    observer_step: Callable[[Vector, Vector, Vector, Vector, float], tuple[Numbers, ...] | None]
    constants: Numbers
    frozen: Numbers
    M_H: tuple[Numbers, ...] | None
    confidence: Confidence
