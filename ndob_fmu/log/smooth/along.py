"""A log as a linear record: the plant's equations about a trajectory of the estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ndob_fmu.log.smooth.events import Jumps
from ndob_fmu.log.smooth.held_steps import HeldSteps
from ndob_fmu.log.smooth.linear_record import LinearRecord
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.row_steps import NODE_WEIGHTS, Motion, StepPlan
from ndob_fmu.log.smooth.smoother import lower_factor
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.layout import Layout
from ndob_fmu.runtime.step.tuned import Tuned

# A jump may be as large as from one bound to the other. Inside a step it stands as jumps at three instants, as in
# `jump_bank`.
_VARIANCE = 2.0


@dataclass(frozen=True)
class Samples:
    """What was measured, at K instants.

    step (K-1,): to the next instant (s)
    inputs (K,m), outputs (K,p): held until the next one; NaN where nothing was measured
    noise_variance (K,p): of each sample
    held: the steps in which surfaces may hold the state; None for a plant without such
    """

    step: Array
    inputs: Array
    outputs: Array
    noise_variance: Array
    held: HeldSteps | None = None

    def first(self, K: int) -> Samples:
        """Return the first K instants."""
        held = None if self.held is None else self.held.first(K - 1)
        return Samples(self.step[: K - 1], self.inputs[:K], self.outputs[:K], self.noise_variance[:K], held)


@dataclass(frozen=True)
class Start:
    """What is known before the first sample: ξ̂ (N,) and a factor (N,N) of its covariance."""

    xi: Array
    factor: Array


def in_layout(trajectory: Array, old: Layout, new: Layout) -> Array:
    """Return a trajectory (K,N) in another layout: another order of d, other offsets; what it does not have is 0."""
    xi = np.zeros((len(trajectory), new.size))
    shared = min(old.order, new.order) * new.q
    xi[:, : new.n + shared] = trajectory[:, : old.n + shared]
    for place, output in enumerate(new.biased):
        if output in old.biased:
            xi[:, new.biases.start + place] = trajectory[:, old.biases.start + old.biased.index(output)]
    xi[:, new.parameters] = trajectory[:, old.parameters]
    xi[:, new.series] *= new.carried
    return xi


def unpacked_rows(layout: Layout, packed: Array) -> Array:
    """Return `Layout.unpacked` of rows (K,·), as (K,N)."""
    places = layout.unpacked(np.arange(packed.shape[1]).tolist()).astype(np.intp)
    return np.asarray(packed[:, places])


def intensities(tuned: Tuned, steps: Array) -> Array:
    """Return `Tuned.intensity` (K,q2) for steps (K,) s, with the noise as told."""
    as_told = [1.0]
    at_tuned = tuned.intensity(tuned.H, as_told)
    lengths: Any = steps[:, None]  # the law's formula takes arrays, too
    scaled = at_tuned if tuned.law is None else tuned.law.scaled(at_tuned, tuned.H, lengths, as_told)
    return np.broadcast_to(scaled, (len(steps), len(at_tuned)))


def plan_along(rows: RowModel, samples: Samples, trajectory: Array) -> StepPlan:
    """Return in which parts steps along a trajectory ξ (K,N) are taken.

    Raises IntegrationError where the equations have no slopes.
    """
    return _motion(rows, samples, trajectory)[0].plan(trajectory[:-1], trajectory[1:])


def record_along(
    rows: RowModel,
    samples: Samples,
    trajectory: Array,
    intensity: Callable[[Array], Array],
    start: Start,
    plan: StepPlan,
    *,
    apart: bool,
) -> tuple[LinearRecord, Jumps]:
    """Return a record about a trajectory ξ (K,N), and the columns of jumps of d at each instant.

    intensity: of the noise behind the r-th derivative of d (K-1,q2), for steps (K-1,) s; or (q2,), the same for all
    start: what is known before the first sample
    plan: as of `plan_along`, of this trajectory
    apart: whether each column of `FilterModel.noise_directions` has N columns of its own in the noise of the record

    Raises IntegrationError where the equations cannot be followed along a step.
    """
    model, K, N = rows.model, *trajectory.shape
    # A sample belongs to the input until then, which outputs with feed-through show.
    before = np.concatenate([samples.inputs[:1], samples.inputs[:-1]])
    sizes = rows.noise_sizes(intensity(samples.step), samples.step)
    held, (motion, more) = samples.held, _motion(rows, samples, trajectory)
    steps = motion.steps(trajectory[:-1], plan, model.noise_directions, sizes, apart=apart)
    noise = np.concatenate([steps.noise, more], axis=2) if more.size else steps.noise
    in_step = np.zeros((K, N, NODE_WEIGHTS.size * model.layout.q))
    weights = np.sqrt(_VARIANCE * NODE_WEIGHTS)[:, None] * model.bound
    np.multiply(steps.jumps, weights, out=in_step[1:].reshape(steps.jumps.shape))
    record = LinearRecord(
        Phi=steps.Phi,
        noise=noise if apart or not more.size else lower_factor(noise),
        shift=steps.end - trajectory[1:],
        rows=rows.output_slopes(trajectory, before),
        misfit=samples.outputs - rows.output(trajectory, before),
        variance=samples.noise_variance,
        start=start.xi - trajectory[0],
        start_factor=start.factor,
    )
    at_sample = np.sqrt(_VARIANCE) * model.jump_channel * model.bound
    every = np.broadcast_to(at_sample, (K, *at_sample.shape))
    if held is not None and not held.shows_jumps:
        # A jump at a sample moves the plant in the step behind it, one in a step in this one and those behind.
        hidden = held.any
        every = every.copy()
        every[:-1][hidden], in_step[1:][hidden] = 0.0, 0.0
    return record, Jumps(every, in_step)


def _motion(rows: RowModel, samples: Samples, trajectory: Array) -> tuple[Motion, Array]:
    """Return the motion of ξ in the steps along a trajectory (K,N), and what surfaces make unknown of it (K-1,N,·)."""
    at, u, H = trajectory[:-1], samples.inputs[:-1], samples.step
    if samples.held is None:
        return Motion(rows, u, H), np.zeros((*at.shape, 0))
    return samples.held.motion(rows, at, u, H)
