"""The design of a filter that knows f: f linearised where the estimate is, no noise on its channel.

It is tuned for one linearisation. The frozen gain, which counts f as noise, needs none, and its error at the same
linearisation says whether it is as good.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.design.augmented import Augmented, augment, discretise
from ndob_fmu.runtime.design.intensity_law import IntensityLaw, law_from_pi, tuned_law
from ndob_fmu.runtime.design.stationary_design import Intensities, StationaryDesign, design_for
from ndob_fmu.runtime.design.tuning import Knowledge, bandwidth_of, f_intensity, squared_errors
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.kalman import converged_factor


@dataclass(frozen=True)
class TrackingDesign:
    """The design at one linearisation.

    stationary: the filter there, at the step H that it was tuned for.
    law: the intensities on the disturbance for every step and noise.
    knows_f: False where the linearisation has no design, so that A alone stands for the plant and f counts as noise.
    cost: √J, the predicted RMS error of d̂ at the sample over D₀, the disturbances' squares summed.
    """

    stationary: StationaryDesign = field(repr=False)
    law: IntensityLaw
    knows_f: bool
    cost: float


def tracking_design(
    equations: Equations,
    parameters: Vector,
    known: Knowledge,
    *,
    order: int,
    H: float,
    alpha: float,
    pi: float,
    x: Vector,
    u: Vector,
) -> TrackingDesign:
    """Design the filter for the plant linearised at x (n,), u (m,), for disturbance order r and a step H (s).

    alpha, pi: α (1/s), which r = 0 needs, and π, which sets the intensities where `known` has no rate (0).

    Raises DesignError where A alone has no design either.
    """
    try:
        return _tuned(augment(linearised(equations, parameters, x, u), order), known, H, alpha, pi, knows_f=True)
    except (DesignError, ArithmeticError, ValueError):  # no stationary gain there, or no slope
        plant = augment(equations.linear_part(parameters), order)
        return _tuned(plant, known, H, alpha, pi, knows_f=False)


def linearised(equations: Equations, parameters: Vector, x: Vector, u: Vector) -> LinearPart:
    """Return the plant's matrices at x (n,), u (m,) and d = 0, with the slope of f in A and no channel of f.

    Raises ArithmeticError or ValueError where there is no slope.
    """
    n, q = len(equations.states), len(equations.disturbances)
    slopes = np.array(equations.linearisation(x, u, [0.0] * q, parameters), dtype=float).reshape(-1, n + q)
    if not np.all(np.isfinite(slopes)):
        raise ArithmeticError
    return LinearPart(
        A=slopes[:n, :n],
        B=equations.linear_part(parameters).B,
        C=slopes[n:, :n],
        G_f=np.zeros((n, 0)),
        G_d=slopes[:n, n:],
        matched=False,
    )


def cost_at(frozen: StationaryDesign, plant: Augmented, known: Knowledge) -> float:
    """Return √J of a frozen gain of order r ≥ 1 on another linearisation `plant`; infinite where its errors grow."""
    actual = discretise(plant, frozen.discrete.H, frozen.alpha)
    K, selector = frozen.K, np.asarray(plant.selector)
    kept = np.eye(len(K)) - K @ plant.C
    with np.errstate(all="ignore"):
        noise = np.linalg.norm(selector @ converged_factor(kept @ actual.Phi, K @ known.R_factor), axis=1)
        before_sample = np.linalg.solve(np.eye(len(K)) - actual.Phi @ kept, actual.drive)
        bias = np.abs(selector @ kept @ before_sample) @ known.disturbance_rate
        cost = float(np.linalg.norm(np.hypot(bias / np.sqrt(3.0), noise) / known.disturbance_bound))
    return cost if np.isfinite(cost) else np.inf


def _tuned(system: Augmented, known: Knowledge, H: float, alpha: float, pi: float, *, knows_f: bool) -> TrackingDesign:
    by_rate = bool(np.all(known.disturbance_rate > 0.0))
    law = tuned_law(system, H, alpha, known) if by_rate else law_from_pi(system, H, pi, known)
    disturbance: Array = law.at(H)
    f = 0.0
    if not knows_f and system.order:
        f = f_intensity(system, H, disturbance, bandwidth_of(system, H, float(disturbance[0]), known), known)
    intensities = Intensities(disturbance=disturbance, f=f)
    stationary = design_for(system, discretise(system, H, alpha), known.R_factor, intensities, alpha)
    cost = float(np.sqrt(np.sum(squared_errors(stationary, known))))
    return TrackingDesign(stationary=stationary, law=law, knows_f=knows_f, cost=cost)
