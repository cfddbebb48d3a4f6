"""What the observers of both methods have in common: the estimate that a step publishes, and how samples are judged."""

from __future__ import annotations

from dataclasses import dataclass

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector


@dataclass  # never changed once made; frozen=True would make that cost a tenth of a step
class Estimate:
    """What a step publishes.

    x_hat (n,) and d_hat (q2,): predictions for the end of the step, x̂(t+H) and d̂(t+H);
    x_at_sample (n,), d_at_sample (q2,), residual (p,): x̂(t), d̂(t), y − C x̂ for the sample that the step began with;
    d_std (q2,): one-sigma error bar of d_hat;
    residual_std (p,): standard deviation that the residual is expected to have, 0 where the method does not say;
    valid: False where that sample could not be used, so that the estimate coasts; the residual of a sample that is not
    finite is 0.
    """

    x_hat: Vector
    d_hat: Vector
    x_at_sample: Vector
    d_at_sample: Vector
    d_std: Vector
    residual: Vector
    residual_std: Vector
    valid: bool


def numbers(vector: Array) -> tuple[float, ...]:
    """Return the entries of a vector as numbers of Python."""
    return tuple(vector.tolist())
