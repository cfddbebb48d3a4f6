"""The steps of plant and observer as functions on scalars, written by `codegen`, and what goes in and out by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

Numbers: TypeAlias = tuple[float, ...]

MEMORY = 100.0  # samples behind a moving average


class Trial(NamedTuple):
    """A substep that was tried.

    x: the state after it (n,)
    error_norm: the norm of its error, at most 1 where the substep may be accepted
    """

    x: Numbers
    error_norm: float


@dataclass(frozen=True, slots=True)
class ConvergedGain:
    """What the observer's steps of one length have in common once the gain has converged.

    gate: largest |e| of a sample that is not suspicious (p,)
    weight: reciprocal variances of the residuals (p,)
    d_std: error bar of d̂ (q2,); at_sample_std: the same at the sample
    residual_std: standard deviations of the residuals (p,)
    K: gain ((n + 3 q2) p,), row by row
    """

    gate: Numbers
    weight: Numbers
    d_std: Numbers
    at_sample_std: Numbers
    residual_std: Numbers
    K: Numbers


class ObserverStep(NamedTuple):
    """What a step of the observer returns. ξ̂ = [x̂; δ₁ δ₂ δ₃], (n + 3 q2,), where δ₁ is d̂, δ₂ and δ₃ its derivatives.

    xi_hat: ξ̂⁻ at the end of the step
    xi_at_sample: ξ̂ after the correction by the sample
    d_hat: δ₁ at the end of the step (q2,)
    innovation: e (p,)
    u: the inputs (m,)
    sample: the sample (p,)
    squares: moving averages of e² over its variance (p,)
    outputs: the output variables of the FMU in their order, `valid` included, as if d̂ were δ₁
    """

    xi_hat: Numbers
    xi_at_sample: Numbers
    d_hat: Numbers
    innovation: Numbers
    u: Numbers
    sample: Numbers
    squares: Numbers
    outputs: Numbers


ObserverStepFunction: TypeAlias = Callable[
    [Numbers, Sequence[float], Numbers, Numbers, ConvergedGain, float], ObserverStep | None
]


@dataclass(frozen=True)
class Steps:
    """The steps as generated functions on scalars. They do what the steps `by_definition` do with NumPy.

    plant_constants(p), observer_constants(p): return all that the steps need of the parameters, passed on as k
    plant_trial(x, u, d, k, h): tries a substep h (s); d (6 q2,) holds the disturbances at the nodes of `integrate`
    observer_step(xi_hat, inputs, squares, k, gain, H): takes a whole step H (s) from ξ̂⁻ with the converged gain; inputs
        (m + p,) are u and the sample y. Returns None where the sample is outside the gate, an input is not finite, or
        the substeps do not reach the end. With a channel, its disturbances are the lumped inputs.
    """

    plant_constants: Callable[[Sequence[float]], Numbers] = field(repr=False)
    plant_trial: Callable[[Numbers, Sequence[float], Sequence[float], Numbers, float], Trial] = field(repr=False)
    observer_constants: Callable[[Sequence[float]], Numbers] = field(repr=False)
    observer_step: ObserverStepFunction = field(repr=False)
