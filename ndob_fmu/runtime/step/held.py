"""What is known of the disturbance while a surface holds the state, as dry friction holds a mass (`numerics.sliding`).

The share α of the upper side in the motion along a surface depends on d. That the surface holds the state says no more
than 0 < α < 1, because all such d hold it. So α is at most as uncertain as a number anywhere between 0 and 1.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.step.error_columns import ErrorColumns, joined
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import LagMemory
from ndob_fmu.runtime.step.fixed_lag import smoothed

# The variance of a number anywhere between 0 and 1.
_ANYWHERE = 1.0 / 12.0
# A state that was on a surface is taken to stay there until d̂ is so many standard deviations beyond what it can hold;
# before that, samples tell better.
_SURE = 3.0
# How far α stays from 0 and 1 where it would leave them.
_INSIDE = 1e-6
# Of a variance across a surface, in natural units: below it, the state is known to be on the surface.
_KNOWN = 1e-20


class Hold(NamedTuple):
    """A surface that holds the state.

    share: α
    row (N + past,): ∂α/∂ξ
    variance: of α, with that of parameters which act as d does
    """

    share: float
    row: Array
    variance: float


def holds(model: FilterModel, xi: Array, columns: ErrorColumns, u: Vector) -> list[Hold]:
    """Return the surfaces on which x̂ is known to be, at ξ̂ (N + past,) and u (m,)."""
    found: list[Hold] = []
    here = model.on_surfaces(xi, u, held=True)
    if here is None:
        return found
    n, N, count = model.layout.n, model.layout.size, columns.factor_count
    for j in range(len(here.held)):
        normal, jump = here.normals[j], float(here.normals[j] @ here.jumps[:, j])
        spread, unit = normal @ columns.factor[:n], float(np.abs(normal) @ model.natural_units[:n])
        if jump >= 0.0 or float(spread @ spread) > _KNOWN * unit * unit:
            continue
        share, way = float(here.shares[j]), here.apart[:, j]
        below, above = xi.copy(), xi.copy()
        below[:n], above[:n] = here.x - way, here.x + way
        F = (1.0 - share) * model.rates(below, u) + share * model.rates(above, u)
        row = np.zeros(len(xi))
        row[:N] = -(normal @ F[:n]) / jump
        row[:n] = 0.0
        seen = row @ columns.values[:, :count]
        found.append(Hold(share, row, float(seen @ seen)))
    return found


def projection_of(model: FilterModel, xi: Array, u: Vector) -> Array | None:
    """Return Π (N,N) of the surfaces that hold x̂ at ξ̂ (N + past,) and u (m,); None where none does."""
    here = model.on_surfaces(xi, u, held=False)
    if here is None or not here.held:
        return None
    projection = np.eye(model.layout.size)
    projection[: model.layout.n, : model.layout.n] = here.projection
    return projection


def limited(
    model: FilterModel, xi: Array, columns: ErrorColumns, lagged: LagMemory, u: Vector
) -> tuple[Array, ErrorColumns, LagMemory]:
    """Return ξ̂, columns and past where α is known no better than that it is between 0 and 1.

    That counts as a measurement of 1/2 which leaves the variance of such a number, as in `bounded`.
    """
    for hold in holds(model, xi, columns, u):
        if hold.variance > _ANYWHERE:
            factor, past = columns.factor, columns.covariance
            seen = hold.row @ factor
            noise = hold.variance * _ANYWHERE / (hold.variance - _ANYWHERE)
            K = (factor @ seen) / (hold.variance + noise) * model.estimated
            e = 0.5 - hold.share
            lagged = smoothed(lagged, hold.row @ past, np.zeros(columns.jump_count), e, hold.variance + noise)
            xi = xi + K * e
            factor = np.column_stack([factor - K[:, None] * seen, K * sqrt(noise)])
            columns = joined(factor, columns.signatures, past - K[:, None] * (hold.row @ past))
    return xi, columns, lagged


def still_held(model: FilterModel, xi: Array, columns: ErrorColumns, u: Vector, H: float) -> Array:
    """Return ξ̂ with a d̂ that does not take the state off its surfaces in a step H (s), unless that is sure."""
    for hold in holds(model, xi, columns, u):
        if hold.variance > 0.0:
            later = hold.share + float(hold.row @ model.coasted(xi, H))
            low, high = min(hold.share, later), max(hold.share, later)
            change = min(1.0 - _INSIDE - high, 0.0) + max(_INSIDE - low, 0.0)
            if change != 0.0 and abs(change) <= _SURE * sqrt(hold.variance) + _INSIDE:
                factor = columns.factor
                xi = xi + (factor @ (hold.row @ factor)) * model.estimated * (change / hold.variance)
    return xi
