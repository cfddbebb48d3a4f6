"""Which entry of the filter's state is what.

    ξ = [x; δ₁ … δ_r; b; θ]        r ≥ 1: δ₁ = d, δ_i' = δ_{i+1}; b: offsets of sensors; θ: uncertain parameters

Rows behind these hold what a delayed sensor measured in the past (`delayed_outputs`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Vector


@dataclass(frozen=True)
class Layout:
    """The places in ξ, N = n + r q + biases + parameters.

    n, q, order: of states, disturbances, and r
    biased: indices of outputs with an offset
    uncertain: indices of uncertain parameters
    """

    n: int
    q: int
    order: int
    biased: tuple[int, ...]
    uncertain: tuple[int, ...]

    @cached_property
    def size(self) -> int:
        """N."""
        return int(self.parameters.stop)

    @cached_property
    def disturbance(self) -> slice:
        """The places of d = δ₁; empty for r = 0."""
        return slice(self.n, self.n + (self.q if self.order else 0))

    @cached_property
    def series(self) -> slice:
        """The places of δ₁ … δ_r."""
        return slice(self.n, self.n + self.order * self.q)

    @cached_property
    def biases(self) -> slice:
        """The places of the offsets."""
        return slice(self.series.stop, self.series.stop + len(self.biased))

    @cached_property
    def parameters(self) -> slice:
        """The places of the uncertain parameters."""
        return slice(self.biases.stop, self.biases.stop + len(self.uncertain))

    @cached_property
    def chain(self) -> Array:
        """Return the constant part of F (N,N): δ_i' = δ_{i+1}."""
        F = np.zeros((self.size, self.size))
        for i in range(self.order - 1):
            row, column = self.n + i * self.q, self.n + (i + 1) * self.q
            F[row : row + self.q, column : column + self.q] = np.eye(self.q)
        return F

    @cached_property
    def last_derivative(self) -> Array:
        """Return the channel (N,q) of what drives δ_r."""
        channel = np.zeros((self.size, self.q))
        channel[self.series.stop - self.q : self.series.stop] = np.eye(self.q)
        return channel

    def packed(self, xi: Array) -> tuple[float, ...]:
        """Return ξ (N,) in the form of the generated step: with zeros for the derivatives of d beyond the order r."""
        missing = (HIGHEST_ORDER - self.order) * self.q
        return (*xi[: self.series.stop].tolist(), *(0.0,) * missing, *xi[self.series.stop : self.size].tolist())

    def unpacked(self, packed: Vector) -> Array:
        """Return ξ (N,) of that form."""
        missing = (HIGHEST_ORDER - self.order) * self.q
        stop = self.series.stop
        return np.array([*packed[:stop], *packed[stop + missing :]], dtype=float)
