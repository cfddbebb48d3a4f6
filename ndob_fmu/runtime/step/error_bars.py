"""Standard deviations of what is published: those of the converged filter, and what the covariance exceeds it by."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.step_designs import StepDesign, squared_norms


def disturbance_std(factor: Array, design: StepDesign) -> Array:
    """Return the error bar (q2,) of d̂ a step ahead, for the factor (N,N) of the covariance there."""
    selector = design.stationary.system.selector
    if selector is None:
        return np.asarray(np.minimum(design.disturbance_std, design.known.disturbance_bound))
    return _with_excess(design.disturbance_std, selector @ factor, design.prior_disturbance_variance)


def held_disturbance_std(before: Array, design: StepDesign, H: float) -> Array:
    """Return the error bar (q2,) of a d̂ that is held over a step H (s) without a sample, for r = 0.

    before (q2,): the error bar at the start. What d may do meanwhile counts like the bias of `tuning.steady_std`.
    """
    return np.asarray(before + design.known.disturbance_rate * H / np.sqrt(3.0))


def residual_std(factor: Array, design: StepDesign) -> Array:
    """Return the standard deviation (p,) of a residual, for the factor (N,N) of the covariance before the sample."""
    C = design.stationary.system.C
    return _with_excess(design.residual_std, C @ factor, design.prior_output_variance)


def _with_excess(converged_std: Array, rows: Array, converged_variance: Array) -> Array:
    """Return standard deviations (k,), for rows (k,N) of the covariance's factor, and what is converged (k,)."""
    excess = np.maximum(squared_norms(rows) - converged_variance, 0.0)
    return np.asarray(np.sqrt(converged_std**2 + excess))
