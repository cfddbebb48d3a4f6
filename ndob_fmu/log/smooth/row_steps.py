"""The step from each row of a log to the next one, for all rows at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.row_transition import RowTransition, row_transition
from ndob_fmu.log.smooth.rows import Rows, not_copied
from ndob_fmu.log.smooth.smoother import lower_factor
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.step.jump_bank import AFTER_JUMPS
from ndob_fmu.runtime.step.time_update import predict_mean

# A part of a step is short enough for Runge's and Kutta's method and for a constant F where ‖F h‖ is below this. Where
# it would take more parts, each row is predicted by itself, by a method for stiff equations.
_SHORT = 0.25
# As in `time_update`: a step in which F H changes by more is taken in so many more parts.
_STRAIGHT = 0.2
# The order of Runge's and Kutta's method, and the last term of a Taylor series above rounding for so short a part.
_ORDER, _HIGHEST_TERM = 4, 10
# Units are chosen for such a share of the rows; with the F of the end of a step a norm may be larger than with that of
# the start.
_USUAL, _CALM = 0.9, 0.22
_MOST_PARTS = 16
# Rates whose slopes change by so many times what the slopes at a few points tell, and by so much, have a kink.
_SEEN, _SHARP = 4.0, 1.0
# A norm above that of all steps that are taken in parts.
_BEYOND = 1e9
_NEAR = 1000
# What is left of a step after the instants of jumps inside it, and their weights.
_AFTER = np.array(AFTER_JUMPS.shares[1:])
NODE_WEIGHTS = np.array([5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0])


@dataclass(frozen=True)
class RowSteps:
    """The steps from K rows.

    end (K,N): ξ at the end
    Phi (K,N,N): Φ of the step
    noise (K,N,·): a factor of the covariance that white noise adds; with N columns for each of a channel, or for all
    jumps (K,N,3,q2): responses at the end to jumps of d at three nodes within the step
    """

    end: Array
    Phi: Array
    noise: Array
    jumps: Array


@dataclass(frozen=True)
class StepPlan:
    """In which parts K steps are taken.

    Steps with slightly different parameters can be compared only where all of them have one plan: another number of
    parts makes another error.

    units (N,): of ξ, in which norms count
    parts (K,): how many
    stiff (K,): whether each part is predicted by a method for stiff equations
    """

    units: Array
    parts: NDArray[np.int_]
    stiff: NDArray[np.bool_]

    def groups(self) -> Iterator[tuple[int, bool, Rows]]:
        """Yield a number of parts, whether they are stiff, and rows, as many as the processor keeps near itself."""
        for stiff in (False, True):
            for count in np.unique(self.parts[self.stiff == stiff]).tolist():
                rows = np.flatnonzero((self.parts == count) & (self.stiff == stiff))
                for some in np.array_split(rows, len(rows) // _NEAR + 1):
                    yield count, stiff, not_copied(some)


@dataclass(frozen=True)
class Motion:
    """The motion of ξ in steps that begin at K rows.

    equations: of all rows
    xi (K,N): ξ there
    u (K,m): inputs
    H (K,): s, to the next row
    projection (K,N,N): onto the ways that ξ can go, where surfaces may hold it
    """

    equations: RowModel
    xi: Array
    u: Array
    H: Array
    projection: Array | None = None

    @cached_property
    def slopes(self) -> Array:
        """F (K,N,N) where the steps begin."""
        return self._slopes(self.xi)

    def plan(self, towards: Array) -> StepPlan:
        """Return in which parts the steps are taken; towards (K,N): where they lead, about.

        Raises IntegrationError where the equations have no slopes.
        """
        model, H = self.equations.model, self.H
        F, longest = self.slopes, float(np.quantile(H, _USUAL, method="higher"))
        usual = np.quantile(np.abs(F[:: len(F) // _NEAR + 1]), _USUAL, axis=0, method="higher")
        most = np.maximum(F.max(axis=0), -F.min(axis=0))
        # In units for the longest step, which a gap makes, all others would take as many parts as that one.
        units = calm_units(usual * longest, model.units(most, longest))
        near = [not_copied(rows) for rows in np.array_split(np.arange(len(F)), len(F) // _NEAR + 1)]
        bends = [self._some(rows)._bends(towards[rows], F[rows], units) for rows in near]
        size, change = (np.concatenate(one) for one in zip(*bends, strict=True))
        if not np.isfinite(size).all():
            raise _left_the_numbers()
        needed = np.maximum(size / _SHORT, change / _STRAIGHT)
        parts = np.minimum(2 ** np.ceil(np.log2(np.maximum(needed, 1.0))), _MOST_PARTS).astype(int)
        return StepPlan(units, parts, size > _MOST_PARTS * _SHORT)

    def _bends(self, towards: Array, F: Array, units: Array) -> tuple[Array, Array]:
        """Return the largest ‖F H‖ (K,) in a step, and by how much F H changes (K,), as far as a few points tell."""
        xi, H = self.xi, self.H
        size, change = _norms(F, units) * H, np.zeros(len(F))
        if self.equations.model.is_linear:
            return size, change
        with np.errstate(invalid="ignore", over="ignore"):
            for at in (0.5 * (xi + towards), towards):
                there = self._slopes(at)
                size = np.fmax(size, _norms(there, units) * H)
                change = np.fmax(change, _norms(there - F, units) * H)
            # A kink of the rates between these points: they change by more than the slopes say.
            rates = self._rates(xi)
            along, most = np.matmul(F, rates[..., None])[..., 0], np.maximum(_SEEN * change, _SHARP)
            for part in (0.5, 1.0):
                h = part * H[:, None]
                more = np.abs((self._rates(xi + h * rates) - rates - h * along) / units).max(axis=1)
                passes = (2.0 / part) * more > most * np.abs(rates / units).max(axis=1)
                size[passes], change[passes] = _BEYOND, _BEYOND
        return size, change

    def steps(self, plan: StepPlan, channel: Array, sizes: Array, *, apart: bool) -> RowSteps:
        """Return the steps, with white noise through a channel (N,c) of sizes (K,c).

        apart: whether the noise through each column of the channel has columns of its own

        Raises IntegrationError where the equations cannot be followed.
        """
        K, N, c, q = len(self.xi), *channel.shape, self.equations.model.layout.q
        found = RowSteps(
            np.empty((K, N)), np.empty((K, N, N)), np.empty((K, N, c * N if apart else N)), np.empty((K, N, 3, q))
        )
        for parts, stiff, rows in plan.groups():
            end, done = self._some(rows)._in_parts(self.slopes[rows], channel, plan.units, parts, stiff=stiff)
            found.end[rows], found.Phi[rows], found.jumps[rows] = end, done.Phi, done.responses
            done.noise[:] *= sizes[rows][:, None, :, None]
            noise = done.noise.reshape(-1, N, c * N)
            found.noise[rows] = noise if apart or c == 1 else lower_factor(noise)
        return found

    def _some(self, rows: Rows) -> Motion:
        projection = None if self.projection is None else self.projection[rows]
        return Motion(self.equations, self.xi[rows], self.u[rows], self.H[rows], projection)

    def _in_parts(
        self, first: Array, channel: Array, units: Array, parts: int, *, stiff: bool
    ) -> tuple[Array, RowTransition]:
        """Return the ends (K,N) of steps in so many parts, and the transitions; first (K,N,N): F where they begin."""
        xi, F, h, jump = self.xi, first, self.H / parts, self.equations.model.jump_channel
        (K, N), c = xi.shape, channel.shape[1]
        Phi, noise = np.broadcast_to(np.eye(N), (K, N, N)), np.zeros((K, N, c, 0))
        for _ in range(parts):
            if stiff and self.projection is None:
                xi = self._predicted_one_by_one(xi, h)
            else:
                xi = self._runge_kutta(xi, h[:, None], F)
            F_end = self._slopes(xi)
            if not np.isfinite(F_end).all():
                raise _left_the_numbers()
            done = row_transition(0.5 * (F + F_end), channel, h, jump, _AFTER, units)
            if parts == 1:
                return xi, done
            moved = (done.Phi @ noise.reshape(K, N, -1)).reshape(noise.shape)
            noise = np.concatenate([moved, done.noise], axis=-1)
            Phi, F = done.Phi @ Phi, F_end
        noise = np.swapaxes(lower_factor(np.swapaxes(noise, 1, 2)), 1, 2)
        whole = row_transition(0.5 * (first + F), channel[:, :0], self.H, jump, _AFTER, units)
        return xi, RowTransition(Phi, noise.copy(), whole.responses)

    def _runge_kutta(self, xi: Array, h: Array, F: Array) -> Array:
        """Return ξ at the end, with the terms of higher order that follow from F (K,N,N) at the start.

        Along thousands of rows a parameter is told more exactly than the error of this method in an oscillation.
        """
        k1 = self._rates(xi)
        k2 = self._rates(xi + 0.5 * h * k1)
        k3 = self._rates(xi + 0.5 * h * k2)
        k4 = self._rates(xi + h * k3)
        term, more = h * k1, np.zeros_like(k1)
        for order in range(2, _HIGHEST_TERM + 1):
            term = h / order * np.matmul(F, term[..., None])[..., 0]
            if order > _ORDER:
                more += term
        return np.asarray(xi + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4) + more)

    def _predicted_one_by_one(self, xi: Array, h: Array) -> Array:
        rows = zip(xi, self.u.tolist(), h.tolist(), strict=True)
        return np.array([predict_mean(self.equations.model, row, inputs, step) for row, inputs, step in rows])

    def _rates(self, xi: Array) -> Array:
        found = self.equations.rates(xi, self.u)
        return found if self.projection is None else np.matmul(self.projection, found[..., None])[..., 0]

    def _slopes(self, xi: Array) -> Array:
        F = self.equations.rates_slopes(xi, self.u)
        return F if self.projection is None else self.projection @ F


def calm_units(X: Array, units: Array) -> Array:
    """Return units (N,) in which no column of X (N,N) ≥ 0 has a sum above c, for the least of c = _CALM · 1, 2, 4 ….

    With w = (I − Xᵀ/c)⁻¹ w₀ it is Xᵀ w = c (w − w₀), for w = 1/u. So a chain of integrators, whose norm depends on the
    units alone, takes no more parts than it needs, nor do two masses on a spring. The units are those given where steps
    take as few parts in them, and where X is too large for all c.
    """
    N, scaled = len(units), X * (units / units[:, None])
    for parts in 2 ** np.arange(_MOST_PARTS.bit_length()):
        calm = np.linalg.solve(np.eye(N) - scaled.T / (_CALM * parts), np.ones(N))
        if np.isfinite(calm).all() and calm.min() >= 1.0:
            return np.asarray(units / calm)
        if scaled.sum(axis=0).max() <= _SHORT * parts:
            break
    return units


def _norms(F: Array, units: Array) -> Array:
    """Return ‖F‖ (K,) of F (K,N,N) in units (N,)."""
    return np.asarray(((1.0 / units) @ np.abs(F) * units).max(axis=1))


def _left_the_numbers() -> IntegrationError:
    return IntegrationError("the observer's estimate leaves the finite numbers")
