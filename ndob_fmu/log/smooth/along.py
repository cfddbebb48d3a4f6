"""A log as a linear record: the plant's equations about a trajectory of the estimate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
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


@dataclass(frozen=True)
class Course:
    """A log along a trajectory, about which the equations are linear. It keeps what a plan and records have in common.

    rows: the equations
    samples: at K instants
    trajectory (K,N): ξ there
    """

    rows: RowModel
    samples: Samples
    trajectory: Array

    @cached_property
    def plan(self) -> StepPlan:
        """In which parts the steps are taken. Raises IntegrationError where the equations have no slopes."""
        return self._motion[0].plan(self.trajectory[1:])

    def record(self, start: Start, intensity: Array, plan: StepPlan, *, apart: bool) -> tuple[LinearRecord, Jumps]:
        """Return a record about the trajectory, and the columns of jumps of d at each instant.

        start: what is known before the first sample
        intensity: of the noise behind the r-th derivative of d (K-1,q2), or (q2,), the same in all steps
        plan: of this course, or of one with slightly different parameters
        apart: whether each column of `FilterModel.noise_directions` has N columns of its own in the noise of the record

        Raises IntegrationError where the equations cannot be followed along a step.
        """
        rows, samples, trajectory = self.rows, self.samples, self.trajectory
        model, K, N = rows.model, *trajectory.shape
        # A sample belongs to the input until then, which outputs with feed-through show.
        before = np.concatenate([samples.inputs[:1], samples.inputs[:-1]])
        sizes = rows.noise_sizes(intensity, samples.step)
        held, (motion, more) = samples.held, self._motion
        steps = motion.steps(plan, model.noise_directions, sizes, apart=apart)
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

    @cached_property
    def _motion(self) -> tuple[Motion, Array]:
        """The motion of ξ in the steps, and what surfaces make unknown of it (K-1,N,·)."""
        at, u, H = self.trajectory[:-1], self.samples.inputs[:-1], self.samples.step
        if self.samples.held is None:
            return Motion(self.rows, at, u, H), np.zeros((*at.shape, 0))
        return self.samples.held.motion(self.rows, at, u, H)
