"""Which samples the sampled-data observer uses, and for which step size it is designed, where the host's steps vary.

A design belongs to one step size. A single shorter step (the last one before a stop time, the one before an event) gets
no design of its own: the estimate is predicted over it, and the sample at its start is not used, since the next one is
as good. Once such steps together are as long as the step of the design, the observer uses a sample again, and is
designed anew for the shorter step.
"""

from __future__ import annotations

from dataclasses import dataclass

# The intensities tuned for one step size serve all that differ from it by no more than this part.
_SIMILAR = 0.1
# The intensities are not tuned for a step below this part of the one before: between such samples the plant moves by
# less than they are rounded to. The first step is compared with that of the default experiment in the same way.
_SHORTEST = 1e-3


@dataclass(frozen=True)
class StepPlan:
    """What one step does with the sample at its start.

    tuned_at: the step (s) that the intensities are tuned for
    designed_for: the step (s) of the gain
    uses_sample: whether the sample is used
    waited: time (s) of the short steps since the last sample that was used; 0 where this one is
    """

    tuned_at: float
    designed_for: float
    uses_sample: bool
    waited: float


def plan_step(H: float, tuned_at: float, waited: float, default_step: float) -> StepPlan:
    """Return what a step H (s) does after short steps that lasted `waited` (s).

    tuned_at: the step (s) that the intensities are tuned for; 0 before the first step, which is compared with
    `default_step` (s), that of the default experiment.
    """
    if tuned_at == 0.0:
        tuned_at = default_step if _SHORTEST * default_step > H else H
    if is_similar(H, tuned_at):
        return StepPlan(tuned_at=tuned_at, designed_for=H, uses_sample=True, waited=0.0)
    waited += H
    if waited < (1.0 - _SIMILAR) * tuned_at:
        return StepPlan(tuned_at=tuned_at, designed_for=tuned_at, uses_sample=False, waited=waited)
    if _SHORTEST * tuned_at > H:
        return StepPlan(tuned_at=tuned_at, designed_for=tuned_at, uses_sample=True, waited=0.0)
    return StepPlan(tuned_at=H, designed_for=H, uses_sample=True, waited=0.0)


def is_similar(H: float, tuned_at: float) -> bool:
    """Return whether intensities tuned for a step `tuned_at` (s) serve a step H (s) too."""
    return abs(H - tuned_at) <= _SIMILAR * tuned_at
