"""Steps in which dry friction may hold the state on a surface g(x, u) = 0 (`runtime.numerics.sliding`).

What is known of such a step does not depend on the disturbance: along the surface ξ goes on with f₋ + Δ α, and α is
anywhere between 0 and 1. When a surface lets the state go, no sample tells at once, so g may change in all of these
steps:

    ξ' = Π f(ξ),   Π = I − Δ (N Δ)⁻¹ N,   and noise of H Δ/√12, one of each surface, in a step H

Jumps of d there do not show. They count as noise of d. What its r-th derivative does while no sample shows it is not
white: that counts, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.events import Events
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.row_steps import Motion
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_model import FilterModel

# The standard deviation of a number anywhere between 0 and 1.
_ANYWHERE = 12.0**-0.5
# So many standard deviations from a surface the smoothed state may be on it.
_SURE = 3.0
# Jumps of d that do not show: how many in a row, at least, and their variance in parts of D₀². Between any two values
# within ±D₀ it is 2/3, and bounds are told with room.
_RATE, _VARIANCE = 3e-4, 1.0 / 3.0


@dataclass(frozen=True)
class HeldSteps:
    """Where surfaces may hold the state.

    by (K-1,k): whether each of the surfaces may do so in a step
    hidden (K-1,): the number of jumps of d that a step is expected to have, where none shows
    shows_jumps: whether jumps in these steps are looked for
    """

    by: NDArray[np.bool_]
    hidden: Array
    shows_jumps: bool

    @property
    def any(self) -> NDArray[np.bool_]:
        """Whether any surface may hold the state in a step (K-1,)."""
        return np.asarray(self.by.any(axis=1))

    def first(self, steps: int) -> HeldSteps:
        """Return those of the first steps."""
        return replace(self, by=self.by[:steps], hidden=self.hidden[:steps])

    def looked_at_again(self, rows: RowModel, trajectory: Array, covariance: Array, inputs: Array) -> HeldSteps:
        """Return these and steps beside them in which the smoothed ξ (K,N), with its covariance, may be there too."""
        table, n = rows.surfaces(trajectory, inputs), rows.model.layout.n
        normals = table[:, :, 1:]
        std = np.sqrt(np.einsum("kjn,knm,kjm->kj", normals, covariance[:, :n, :n], normals).clip(0.0))
        by = self.by.copy()
        for j in range(by.shape[1]):
            for first, stop in stretches(self.by[:, j]):
                near = np.abs(table[:, j, 0]) <= _SURE * float(np.median(std[first : stop + 1, j]))
                away = np.flatnonzero(~near)
                before, behind = away[away < first], away[away > stop]
                by[before[-1] if len(before) else 0 : behind[0] if len(behind) else None, j] = True
        return replace(self, by=by)

    def widened(self, rows: int) -> HeldSteps:
        """Return these and so many steps beside them."""
        by = self.by.copy()
        for shift in range(1, min(rows, len(by) - 1) + 1):
            by[shift:] |= self.by[:-shift]
            by[:-shift] |= self.by[shift:]
        return replace(self, by=by)

    def with_hidden(self, events: Events) -> tuple[HeldSteps, Events]:
        """Return it with the jumps of events in its steps, each anywhere in its stretch; and the other events."""
        K, found = len(self.by), np.zeros(len(self.by) + 1)
        hidden = np.full(K, max(_RATE, (len(events.jumps) + 1) / K))
        found[[*events.jumps]] = 1.0
        for first, stop in stretches(self.any):
            count = found[first : stop + 1].sum()
            if count:
                hidden[first:stop] = np.maximum(hidden[first:stop], count / (stop - first))
        held = np.append(self.any, False) | np.append(False, self.any)
        jumps = {k: in_step for k, in_step in events.jumps.items() if not held[k]}
        return replace(self, hidden=hidden, shows_jumps=False), Events(jumps, events.outliers)

    def letting_go_of_jumps(self) -> HeldSteps:
        """Return it with one hidden jump in each stretch."""
        return self.with_hidden(Events({first: False for first, _ in stretches(self.any)}))[0]

    def motion(self, rows: RowModel, xi: Array, u: Array, H: Array) -> tuple[Motion, Array]:
        """Return the motion in steps H (K,) s from ξ (K,N), and what is unknown of it, as noise (K,N,·).

        The columns of this noise are a multiple of N.
        """
        (K, N), n, q = xi.shape, rows.model.layout.n, rows.model.layout.q
        count, table = self.by.shape[1], rows.surfaces(xi, u)
        projection = np.tile(np.eye(N), (K, 1, 1))
        noise = np.zeros((K, N, N * -(-(count + 2 * q) // N)))
        for some in np.unique(self.by[self.any], axis=0):
            at, which = np.flatnonzero((self.by == some).all(axis=1)), np.flatnonzero(some)
            normals, g = table[at][:, which, 1:], table[at][:, which, 0]
            jumps = np.stack([rows.jump(xi[at], u[at], normals[:, j], g[:, j]) for j in range(len(which))], axis=2)
            projection[at, :, :n] -= jumps @ np.linalg.pinv(normals @ jumps[:, :n]) @ normals
            noise[at[:, None], :, which] = np.swapaxes(jumps, 1, 2) * (_ANYWHERE * H[at])[:, None, None]
        unseen = np.sqrt(_VARIANCE * self.hidden * self.any)[:, None, None] * rows.model.jump_channel
        noise[:, :, count : count + q] = unseen * rows.model.bound
        noise[:, :, count + q : count + 2 * q] = self._sustained(rows.model, H)
        return Motion(rows, xi, u, H, projection), noise

    def _sustained(self, model: FilterModel, H: Array) -> Array:
        """Return noise of the r-th derivatives of d (K,N,q2), which does in a stretch what sines at their bounds do.

        White noise of the intensity s gives d the variance s T^{2r−1}/((2r−1) (r−1)!²) in T s, a constant c gives it
        c² T^{2r}/r!². With r = 1, d is a walk or jumps, and its pace is that of the white noise.
        """
        lasts, r = np.zeros(len(H)), model.layout.order
        if r == 1:
            return np.zeros((len(H), *model.layout.last_derivative.shape))
        for first, stop in stretches(self.any):
            lasts[first:stop] = H[first:stop].sum()
        rate = np.array(model.settings.disturbance_rate, dtype=float)
        size = np.sqrt(lasts * H * (2 * r - 1) / (2.0 * r**2))
        return np.asarray(size[:, None, None] * model.layout.last_derivative * rate)


def limited(
    rows: RowModel, held: HeldSteps, xi: Array, covariance: Array, u: Array, d: Array, variance: Array
) -> tuple[Array, Array]:
    """Return d (K,q2) and its variance where α is told no better than that it is between 0 and 1.

    That counts as a measurement of 1/2 which leaves the variance of such a number, as in `runtime.step.held`.

    xi (K,N), covariance (K,N,N): smoothed, at inputs (K,m)
    """
    model = rows.model
    places = model.layout.disturbance
    by = np.concatenate([held.by, held.by[-1:]])
    d, variance = d.copy(), variance.copy()
    for j in range(by.shape[1]):
        at = np.flatnonzero(by[:, j])
        table = rows.surfaces(xi[at], u[at])[:, j]
        normals, g = table[:, 1:], table[:, 0]
        share, row = rows.share(xi[at], u[at], normals, g)
        seen = (row[:, None] @ covariance[at])[:, 0]
        spread = np.maximum((seen * row).sum(axis=1), _ANYWHERE**2)
        gain = seen[:, places] * ((spread - _ANYWHERE**2) / spread**2)[:, None]
        d[at] += gain * (0.5 - share)[:, None]
        variance[at] -= gain * seen[:, places]
    return d, variance


def stretches(there: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return where stretches of true entries begin and end, (first, last + 1)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    return [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]


def held_at_first(rows: RowModel, trajectory: Array, inputs: Array, *, passing: bool) -> HeldSteps:
    """Return in which steps surfaces may hold the state, by the online estimate ξ (K,N).

    passing: whether they may do so where it only passes them, too
    """
    table, n = rows.surfaces(trajectory, inputs), rows.model.layout.n
    g, normals = table[:, :, 0], table[:, :, 1:]
    on = np.abs(g) <= rows.rounding(trajectory, normals)
    by = np.zeros((len(g) - 1, g.shape[1]), dtype=bool)
    for j in range(g.shape[1]):
        passes = np.append(g[1:, j] * g[:-1, j] < 0.0, False)
        near = np.flatnonzero(on[:, j] | (passing & passes))
        jump = rows.jump(trajectory[near], inputs[near], normals[near, j], g[near, j])
        holds = near[(jump[:, :n] * normals[near, j]).sum(axis=1) < 0.0]
        for shift in (-2, -1, 0, 1):
            by[np.clip(holds + shift, 0, len(by) - 1), j] = True
    return HeldSteps(by, np.full(len(by), _RATE), shows_jumps=True)
