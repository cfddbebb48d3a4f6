"""The equations of `FilterModel` for all rows of a log at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ndob_fmu.codegen.row_functions import RowFunction, RowFunctions
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.filter_model import FilterModel

# Rounding of x may take g so far from 0, in parts of what the states make of it.
_ROUNDING, _LEAST = 1e-9, 1e-150


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

        def across(far: float) -> Array:
            below, above = (self._beside(xi, normals, g, side * far) for side in (-1.0, 1.0))
            return self.rates(above, u) - self.rates(below, u)

        return 2.0 * across(1.0) - across(2.0)

    def share(self, xi: Array, u: Array, normals: Array, g: Array) -> tuple[Array, Array]:
        """Return α (K,) of a surface that holds ξ, and ∂α/∂ξ (K,N) with regard to what is not a state of the plant."""
        n = self.model.layout.n
        jump = self.jump(xi, u, normals, g)[:, :n]
        across = -1.0 / (normals * jump).sum(axis=1)
        below = self._beside(xi, normals, g, -1.0)
        row = across[:, None] * (normals[:, None] @ self.rates_slopes(below, u)[:, :n])[:, 0]
        row[:, :n] = 0.0
        return across * (normals * self.rates(below, u)[:, :n]).sum(axis=1), row

    def rounding(self, xi: Array, normals: Array) -> Array:
        """Return the size (K,…) below which g of surfaces is 0 but for rounding of ξ; normals (K,…,n)."""
        of_states = (np.abs(normals) @ np.abs(xi[:, : self.model.layout.n, None]))[..., 0]
        return np.asarray(_ROUNDING * of_states + _LEAST)

    def _beside(self, xi: Array, normals: Array, g: Array, side: float) -> Array:
        """Return ξ (K,N) moved to where g is so many times its rounding."""
        moved = xi.copy()
        room = self.rounding(xi, normals[:, None])[:, 0]
        moved[:, : self.model.layout.n] -= normals * ((g - side * room) / (normals**2).sum(axis=1))[:, None]
        return np.asarray(moved)

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

    def rates(self, xi: Array, u: Array) -> Array:
        """Return ξ' (K,N)."""
        n = self.model.layout.n
        rates = xi @ self.model.layout.chain.T
        rates[:, :n] = self._value(self.functions.derivatives, slice(n), xi, u)
        return np.asarray(rates)

    def rates_slopes(self, xi: Array, u: Array) -> Array:
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


def _within(values: Array, limits: Array) -> Array:
    return np.clip(values, *limits) if np.isfinite(limits).any() else values
