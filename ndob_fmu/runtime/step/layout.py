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
    own (q2,): the order r_j ≤ r of each disturbance; its derivatives from the r_j-th on are 0
    biased: indices of outputs with an offset
    uncertain: indices of uncertain parameters
    """

    n: int
    q: int
    order: int
    own: tuple[int, ...]
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
            for j in range(self.q):
                if self.own[j] > i + 1:
                    F[self.n + i * self.q + j, self.n + (i + 1) * self.q + j] = 1.0
        return F

    @cached_property
    def last_derivative(self) -> Array:
        """Return the channel (N,q) of what drives δ_r, of each disturbance with its own r."""
        channel = np.zeros((self.size, self.q))
        for j in range(self.q):
            channel[self.n + (self.own[j] - 1) * self.q + j, j] = 1.0
        return channel

    @cached_property
    def carried(self) -> Array:
        """Return 1 for each of δ₁ … δ_r (r q,) that its disturbance has, 0 for one that stays 0."""
        mask = np.zeros(self.order * self.q)
        for i in range(self.order):
            for j in range(self.q):
                mask[i * self.q + j] = 1.0 if self.own[j] > i else 0.0
        return mask

    @property
    def is_mixed(self) -> bool:
        """Whether the disturbances have different orders."""
        return min(self.own) < self.order

    def packed(self, xi: Array) -> tuple[float, ...]:
        """Return ξ (N,) in the form of the generated step: with zeros for the derivatives of d beyond the order r."""
        missing = (HIGHEST_ORDER - self.order) * self.q
        return (*xi[: self.series.stop].tolist(), *(0.0,) * missing, *xi[self.series.stop : self.size].tolist())

    def unpacked(self, packed: Vector) -> Array:
        """Return ξ (N,) of that form."""
        missing = (HIGHEST_ORDER - self.order) * self.q
        stop = self.series.stop
        return np.array([*packed[:stop], *packed[stop + missing :]], dtype=float)
