"""The equations of `FilterModel` for all rows of a log at once, and the step from each row to the next one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.codegen.row_functions import RowFunction, RowFunctions
from ndob_fmu.log.smooth.row_transition import RowTransition, row_transition
from ndob_fmu.log.smooth.rows import Rows, not_copied
from ndob_fmu.log.smooth.smoother import lower_factor
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.jump_bank import AFTER_JUMPS
from ndob_fmu.runtime.step.time_update import predict_mean

# A part of a step is short enough for Runge's and Kutta's method and for a constant F where ‖F h‖ is below this. Where
# it would take more parts, each row is predicted by itself, by a method for stiff equations.
_SHORT = 0.25
# The order of Runge's and Kutta's method, and the last term of a Taylor series above rounding for so short a part.
_ORDER, _HIGHEST_TERM = 4, 10
# Units are chosen for such a share of the rows; with the F of the end of a step a norm may be larger than with that of
# the start.
_USUAL, _CALM = 0.9, 0.22
_MOST_PARTS = 16
# Rounding of x may take g so far from 0, in parts of what the states make of it.
_BESIDE, _LEAST = 1e-9, 1e-150
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
class RowModel:
    """An observer's equations for rows ξ (K,N) and u (K,m).

    Uncertain parameters are those of the rows, also where the observer only considers them: all samples together tell
    them. Those that act as d does stay as told.

    Outside the ranges of states and inputs they go on along their tangent, as `design.ranges` says.
    """

    model: FilterModel
    functions: RowFunctions

    def output(self, xi: Array, u: Array) -> Array:
        """Return ŷ (K,p), offsets included."""
        layout = self.model.layout
        y = self._value(self.functions.output, slice(layout.n, None), xi, u)
        for place, output in enumerate(layout.biased):
            y[:, output] += xi[:, layout.biases.start + place]
        return y

    def surfaces(self, xi: Array, u: Array) -> Array:
        """Return [g, ∂g/∂x] (K,k,1 + n) of the surfaces at which ẋ jumps."""
        return self.functions.surfaces(*self._arguments(xi, u))

    def jump(self, xi: Array, u: Array, normals: Array, g: Array) -> Array:
        """Return Δ (K,N), by how much ξ' is larger above a surface than below it; normals (K,n) and g (K,): of it."""
        n, way = self.model.layout.n, normals / (normals**2).sum(axis=1)[:, None]
        room = _BESIDE * (np.abs(normals) * np.abs(xi[:, :n])).sum(axis=1) + _LEAST

        def across(room: Array) -> Array:
            below, above = xi.copy(), xi.copy()
            below[:, :n] -= way * (g + room)[:, None]
            above[:, :n] -= way * (g - room)[:, None]
            return self._rates(above, u) - self._rates(below, u)

        return 2.0 * across(room) - across(2.0 * room)

    def share(self, xi: Array, u: Array, normals: Array, g: Array) -> tuple[Array, Array]:
        """Return α (K,) of a surface that holds ξ, and ∂α/∂ξ (K,N) with regard to what is not a state of the plant."""
        n = self.model.layout.n
        jump = self.jump(xi, u, normals, g)[:, :n]
        across = -1.0 / (normals * jump).sum(axis=1)
        below = xi.copy()
        room = _BESIDE * (np.abs(normals) * np.abs(xi[:, :n])).sum(axis=1) + _LEAST
        below[:, :n] -= normals * ((g + room) / (normals**2).sum(axis=1))[:, None]
        row = across[:, None] * (normals[:, None] @ self._rates_slopes(below, u)[:, :n])[:, 0]
        row[:, :n] = 0.0
        return across * (normals * self._rates(below, u)[:, :n]).sum(axis=1), row

    def output_slopes(self, xi: Array, u: Array) -> Array:
        """Return C (K,p,N)."""
        layout, n = self.model.layout, self.model.layout.n
        both, by_parameters = self._slopes(xi, u)
        C = np.zeros((len(xi), both.shape[1] - n, layout.size))
        C[:, :, :n] = both[:, n:, :n]
        C[:, :, layout.parameters] = by_parameters[:, n:]
        for place, output in enumerate(layout.biased):
            C[:, output, layout.biases.start + place] = 1.0
        return C

    def taken_for_disturbance(self, xi: Array, u: Array) -> Array:
        """Return `FilterModel.taken_for_disturbance` (K,q2)."""
        model, n = self.model, self.model.layout.n
        if not np.any(model.like_disturbance):
            return np.zeros((len(xi), model.layout.q))
        both, by_parameters = self._slopes(xi, u)
        size, std = model.start_std[:n, None], model.like_disturbance * model.start_std[model.layout.parameters]
        W = np.linalg.pinv(both[:, :n, n:] / size) @ (by_parameters[:, :n] / size)
        return np.asarray(((W * std) ** 2).sum(axis=2))

    def noise_sizes(self, intensity: Array, H: Array) -> Array:
        """Return `FilterModel.noise_sizes` (K,c) in steps H (K,) s; intensity (K,q2), or (q2,) for all."""
        told, undriven = np.array(self.model.settings.state_noise, dtype=float), self.model.undriven
        noisy = told + undriven > 0.0
        on_states = told[noisy] ** 2 + undriven[noisy] * H[:, None]
        on_d = np.broadcast_to(intensity, (len(H), self.model.layout.q))
        return np.asarray(np.sqrt(np.hstack([on_d, on_states])))

    def steps(
        self,
        xi: Array,
        u: Array,
        H: Array,
        channel: Array,
        sizes: Array,
        *,
        apart: bool,
        projection: Array | None = None,
    ) -> RowSteps:
        """Return the steps of H (K,) s from each row, with white noise through a channel (N,c) of sizes (K,c).

        apart: whether the noise through each column of the channel has columns of its own
        projection (K,N,N): onto the ways that ξ can go, where surfaces may hold it

        Raises IntegrationError where the equations cannot be followed.
        """
        F = _turned(self._rates_slopes(xi, u), projection)
        # In units for the usual step rows take fewer parts, too few where slopes change within a step, as at the kink
        # of a friction: `fit` kept a wrong inertia.
        longest = float(np.max(H))
        usual = np.quantile(np.abs(F[:: len(F) // _NEAR + 1]), _USUAL, axis=0, method="higher")
        most = np.maximum(F.max(axis=0), -F.min(axis=0))
        units = calm_units(usual * longest, self.model.units(most, longest))
        near = np.array_split(F, len(F) // _NEAR + 1)
        size = np.concatenate([((1.0 / units) @ np.abs(some) * units).max(axis=1) for some in near]) * H
        if not np.isfinite(size).all():
            raise _left_the_numbers()
        K, N, c, q = len(xi), *channel.shape, self.model.layout.q
        parts = np.minimum(2 ** np.ceil(np.log2(np.maximum(size / _SHORT, 1.0))), _MOST_PARTS).astype(int)
        found = RowSteps(
            np.empty((K, N)), np.empty((K, N, N)), np.empty((K, N, c * N if apart else N)), np.empty((K, N, 3, q))
        )
        for count, rows in _groups(parts):
            stiff = bool(np.max(size[rows]) > count * _SHORT)
            way = None if projection is None else projection[rows]
            end, done = self._in_parts(xi[rows], u[rows], H[rows], F[rows], channel, units, count, way, stiff=stiff)
            found.end[rows], found.Phi[rows], found.jumps[rows] = end, done.Phi, done.responses
            done.noise[:] *= sizes[rows][:, None, :, None]
            noise = done.noise.reshape(-1, N, c * N)
            found.noise[rows] = noise if apart or c == 1 else lower_factor(noise)
        return found

    def _in_parts(
        self,
        xi: Array,
        u: Array,
        H: Array,
        F: Array,
        channel: Array,
        units: Array,
        parts: int,
        projection: Array | None,
        *,
        stiff: bool,
    ) -> tuple[Array, RowTransition]:
        """Return the ends (K,N) of steps in so many parts, and the transitions; F (K,N,N) is that of their start."""
        K, N, c = len(xi), *channel.shape
        h, first, jump = H / parts, F, self.model.jump_channel
        Phi, noise = np.broadcast_to(np.eye(N), (K, N, N)), np.zeros((K, N, c, 0))
        for _ in range(parts):
            if stiff and projection is None:
                xi = self._predicted_one_by_one(xi, u, h)
            else:
                xi = self._runge_kutta(xi, u, h[:, None], F, projection)
            F_end = _turned(self._rates_slopes(xi, u), projection)
            if not np.isfinite(F_end).all():
                raise _left_the_numbers()
            done = row_transition(0.5 * (F + F_end), channel, h, jump, _AFTER, units)
            if parts == 1:
                return xi, done
            moved = (done.Phi @ noise.reshape(K, N, -1)).reshape(noise.shape)
            noise = np.concatenate([moved, done.noise], axis=-1)
            Phi, F = done.Phi @ Phi, F_end
        noise = np.swapaxes(lower_factor(np.swapaxes(noise, 1, 2)), 1, 2)
        whole = row_transition(0.5 * (first + F), channel[:, :0], H, jump, _AFTER, units)
        return xi, RowTransition(Phi, noise.copy(), whole.responses)

    def _runge_kutta(self, xi: Array, u: Array, h: Array, F: Array, projection: Array | None) -> Array:
        """Return ξ at the end, with the terms of higher order that follow from F (K,N,N) at the start.

        Along thousands of rows a parameter is told more exactly than the error of this method in an oscillation.
        """

        def rates(xi: Array) -> Array:
            found = self._rates(xi, u)
            return found if projection is None else np.matmul(projection, found[..., None])[..., 0]

        k1 = rates(xi)
        k2 = rates(xi + 0.5 * h * k1)
        k3 = rates(xi + 0.5 * h * k2)
        k4 = rates(xi + h * k3)
        term, more = h * k1, np.zeros_like(k1)
        for order in range(2, _HIGHEST_TERM + 1):
            term = h / order * np.matmul(F, term[..., None])[..., 0]
            if order > _ORDER:
                more += term
        return np.asarray(xi + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4) + more)

    def _predicted_one_by_one(self, xi: Array, u: Array, h: Array) -> Array:
        rows = zip(xi, u.tolist(), h.tolist(), strict=True)
        return np.array([predict_mean(self.model, row, inputs, step) for row, inputs, step in rows])

    def _rates(self, xi: Array, u: Array) -> Array:
        """Return ξ' (K,N)."""
        n = self.model.layout.n
        rates = xi @ self.model.layout.chain.T
        rates[:, :n] = self._value(self.functions.derivatives, slice(n), xi, u)
        return np.asarray(rates)

    def _rates_slopes(self, xi: Array, u: Array) -> Array:
        """Return F (K,N,N)."""
        layout, n = self.model.layout, self.model.layout.n
        both, by_parameters = self._slopes(xi, u)
        F = np.tile(layout.chain, (len(xi), 1, 1))
        F[:, :n, :n] = both[:, :n, :n]
        if layout.order:
            F[:, :n, layout.disturbance] = both[:, :n, n:]
        F[:, :n, layout.parameters] = by_parameters[:, :n] * (1.0 - self.model.like_disturbance)
        return F

    def _value(self, function: RowFunction, rows: slice, xi: Array, u: Array) -> Array:
        x_in, u_in, d, p = self._arguments(xi, u)
        value = function(x_in, u_in, d, p)
        x = xi[:, : self.model.layout.n]
        outside = np.flatnonzero((x != x_in).any(axis=1) | (u != u_in).any(axis=1))
        if len(outside):
            at = [part[outside] for part in (x_in, u_in, d, p)]
            by_x = self.functions.slopes(*at)[:, rows, : x.shape[1]]
            by_u = self.functions.input_slopes(*at)[:, rows]
            value[outside] += (by_x @ (x - x_in)[outside, :, None])[:, :, 0]
            value[outside] += (by_u @ (u - u_in)[outside, :, None])[:, :, 0]
        return value

    def _slopes(self, xi: Array, u: Array) -> tuple[Array, Array]:
        """Return the slopes of ẋ and y, (K,n + p,n + q2), and those by uncertain parameters."""
        arguments, uncertain = self._arguments(xi, u), self.model.layout.uncertain
        both = self.functions.slopes(*arguments)
        if not uncertain:
            return both, np.zeros((*both.shape[:2], 0))
        return both, self.functions.sensitivity(*arguments)[:, :, list(uncertain)]

    def _arguments(self, xi: Array, u: Array) -> tuple[Array, Array, Array, Array]:
        """Return x and u inside their ranges, d and p."""
        model, layout = self.model, self.model.layout
        of_x, of_u = self._limits
        d = xi[:, layout.disturbance] if layout.order else np.zeros((len(xi), layout.q))
        p = np.broadcast_to(np.array(model.parameters, dtype=float), (len(xi), len(model.parameters)))
        told = [i for i, like in zip(layout.uncertain, model.like_disturbance, strict=True) if not like]
        if told:
            p = p.copy()
            p[:, told] = xi[:, layout.parameters][:, model.like_disturbance == 0.0]
        return _within(xi[:, : layout.n], of_x), _within(u, of_u), d, p

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        """The ranges of x (2,n) and u (2,m)."""
        eq, free = self.model.equations, (-np.inf, np.inf)
        of_x, of_u = (
            np.array([eq.ranges.get(name, free) for name in names], dtype=float).reshape(-1, 2).T
            for names in (eq.states, eq.inputs)
        )
        return of_x, of_u


def _turned(F: Array, projection: Array | None) -> Array:
    return F if projection is None else projection @ F


def _within(values: Array, limits: Array) -> Array:
    return np.clip(values, *limits) if np.isfinite(limits).any() else values


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


def _groups(parts: NDArray[np.int_]) -> Iterator[tuple[int, Rows]]:
    """Yield a number of parts and rows that have it, as many as the processor keeps near itself."""
    for count in np.unique(parts).tolist():
        rows = np.flatnonzero(parts == count)
        for some in np.array_split(rows, len(rows) // _NEAR + 1):
            yield count, not_copied(some)


def _left_the_numbers() -> IntegrationError:
    return IntegrationError("the observer's estimate leaves the finite numbers")
