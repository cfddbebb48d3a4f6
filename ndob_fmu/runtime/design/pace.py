"""Whether the disturbance's rate and the step fit the time constants of the plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.operating_point import driven_modes, tangent
from ndob_fmu.runtime.equations import Equations, Vector

_SLOW = 1e-4  # of the fastest mode: slower ones count as integrators
# What is absurd: a disturbance so many times faster than the plant's fastest mode; one that turns by so much within a
# step, in rad; steps of so many of the longest time constant, and of so small a part of the shortest, also of the
# disturbance's.
_TOO_FAST = 100.0
_WITHIN_A_STEP = 2.0
_TOO_LONG, _TOO_SHORT = 3.0, 1e-4


@dataclass(frozen=True)
class Pace:
    """How fast plant and disturbance are.

    slowest, fastest: magnitudes (1/s) of the plant's modes that the disturbance drives, integrators left out; 0 where
        there are none
    disturbance (q2,): ω (rad/s) of sines at the bounds of d and of its r-th derivative; 0 where no rate is told
    """

    slowest: float
    fastest: float
    disturbance: Array


def pace_of(
    equations: Equations, parameters: Vector, x_hat: Vector, *, bound: Vector, rate: Vector, order: int
) -> Pace:
    """Return the pace of the plant, linearised where it works, and of a disturbance of order r."""
    omega = (np.array(rate, dtype=float) / np.array(bound, dtype=float)) ** (1.0 / max(order, 1))
    found = tangent(equations, parameters, x_hat)
    modes = np.zeros(0) if found is None else np.abs(driven_modes(found.A, found.G_d))
    moving = modes[modes > _SLOW * max(modes, default=0.0)]
    if not len(moving):
        return Pace(0.0, 0.0, omega)
    return Pace(float(np.min(moving)), float(np.max(moving)), omega)


@dataclass(frozen=True)
class Absurd:
    """What is absurd for the plant.

    too_fast, within_a_step (q2,): 1 for a disturbance that is so, else 0
    too_long, too_short: whether the step is
    """

    too_fast: Array
    within_a_step: Array
    too_long: bool
    too_short: bool


def absurd(pace: Pace, H: float) -> Absurd:
    """Return what is absurd with a step H (s), 0 before there is one."""
    quickest = max(pace.fastest, float(np.max(pace.disturbance)))
    return Absurd(
        too_fast=np.where((pace.disturbance > _TOO_FAST * pace.fastest) & (pace.fastest > 0.0), 1.0, 0.0),
        within_a_step=np.where(pace.disturbance * H > _WITHIN_A_STEP, 1.0, 0.0),
        too_long=H * pace.slowest > _TOO_LONG,
        too_short=H > 0.0 and pace.fastest > 0.0 and H * quickest < _TOO_SHORT,
    )


def pace_warnings(pace: Pace, disturbances: Sequence[str], H: float | None) -> list[str]:
    """Return one sentence for each rate, and for the step H (s), that is absurd for the plant; None: no step yet."""
    found, step = [], H or 0.0
    judged = absurd(pace, step)
    for i, (name, omega) in enumerate(zip(disturbances, pace.disturbance.tolist(), strict=True)):
        if judged.too_fast[i]:
            found.append(
                f"disturbance_rate lets {name} change at {omega:.3g} rad/s, {omega / pace.fastest:.0f} times the "
                f"plant's fastest mode ({pace.fastest:.3g} 1/s), so that its estimate will be mostly noise"
            )
        if judged.within_a_step[i]:
            found.append(
                f"disturbance_rate lets {name} change at {omega:.3g} rad/s, which samples {step:g} s apart cannot "
                "follow: a shorter step or a lower rate is needed"
            )
    if judged.too_long:
        found.append(
            f"the step of {step:g} s is {step * pace.slowest:.3g} times the plant's longest time constant "
            f"({1.0 / pace.slowest:.3g} s): samples show only what has settled; take shorter steps"
        )
    if judged.too_short:
        found.append(
            f"the step of {step:g} s is {step * pace.fastest:.1g} of the plant's shortest time constant "
            f"({1.0 / pace.fastest:.3g} s): samples tell nothing new; take longer steps"
        )
    return found
