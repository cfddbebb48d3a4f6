"""What the observers of both methods have in common: their methods, and the estimate that a step publishes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector


@dataclass  # never changed once made; frozen=True would make that cost a tenth of a step
class Estimate:
    """What a step publishes.

    x_hat (n,): x̂(t+H), the prediction for the end of the step.
    d_hat (q2,): d̂(t+H), the same for the disturbances.
    x_at_sample (n,): x̂(t), for the sample that the step began with.
    d_at_sample (q2,): d̂(t).
    d_std (q2,): one-sigma error bar of d_hat.
    d_lagged, d_lagged_std (q2,): d̂ and its error bar a lag before the sample; at the sample from method 1.
    residual (p,): y − C x̂(t) before the sample was used; 0 for a sample that is not finite.
    residual_std (p,): standard deviation expected of the residual; 0 from method 1, which predicts none.
    valid: False where no output has been used for too long, or the estimate is known to be lost.
    consistency: moving average of squared residuals over their expectation; 0 from method 1.
    """

    x_hat: Vector
    d_hat: Vector
    x_at_sample: Vector
    d_at_sample: Vector
    d_std: Vector
    d_lagged: Vector
    d_lagged_std: Vector
    residual: Vector
    residual_std: Vector
    valid: bool
    consistency: float


class State(Protocol):
    """What is read of the state of an observer from outside."""

    @property
    def u(self) -> Vector | Array:
        """The last finite input (m,)."""


S = TypeVar("S", bound=State)


class Observer(Protocol[S]):
    """An observer, which remembers nothing itself: a step leads from one state to the next."""

    def init(self, x_hat: Vector) -> S:
        """Return the state that starts from x̂₀ (n,)."""

    def possible(self, state: S) -> bool:
        """Return whether numbers in the form of a state can be one."""

    def estimate(self, state: S, y: Vector) -> Estimate:
        """Return what is known at a sample y (p,) before any step from it."""

    def step(self, state: S, u: Vector, y: Vector, H: float) -> tuple[S, Estimate]:
        """Advance by H > 0 s from a sample y (p,), with the input u (m,) held over the step."""


def numbers(vector: Array) -> tuple[float, ...]:
    """Return the entries of a vector as numbers of Python."""
    return tuple(vector.tolist())
