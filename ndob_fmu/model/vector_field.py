"""The right-hand side of a model, ẋ and y, and ∂f/∂x: put together here once, for code, pages and checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy

Symbols = tuple[sympy.Symbol, ...]
Expressions = tuple[sympy.Expr, ...]


@dataclass(frozen=True)
class VectorField:
    """ẋ = A x + B u + G_f f(x, u) + G_d w, y = C x, in symbols; w = d, or w = n(x, u) d with a channel.

    x: states (n,)
    u: inputs (m,)
    d: disturbances (q2,)
    p: parameters
    A, B, C, G_f, G_d: matrices with entries in p
    f: nonlinearity (q1,), in x, u and p
    direction: n (k,) of the channel, in x, u and p; empty without a channel
    """

    x: Symbols
    u: Symbols
    d: Symbols
    p: Symbols
    A: sympy.ImmutableMatrix
    B: sympy.ImmutableMatrix
    C: sympy.ImmutableMatrix
    G_f: sympy.ImmutableMatrix
    G_d: sympy.ImmutableMatrix
    f: Expressions
    direction: Expressions

    def derivatives(self, w: Sequence[sympy.Expr]) -> Expressions:
        """Return ẋ (n,) for one expression w for each column of G_d."""
        total = self.A * sympy.Matrix(self.x)
        if self.u:
            total += self.B * sympy.Matrix(self.u)
        if self.f:
            total += self.G_f * sympy.Matrix(self.f)
        return tuple(total + self.G_d * sympy.Matrix(w))

    def driven_by(self, d: Sequence[sympy.Expr]) -> Expressions:
        """Return w, what acts through the columns of G_d, for the disturbances d (q2,)."""
        return tuple(n * d[0] for n in self.direction) or tuple(d)

    @property
    def outputs(self) -> Expressions:
        """y = C x, (p,)."""
        return tuple(self.C * sympy.Matrix(self.x))

    @cached_property
    def jacobian(self) -> sympy.ImmutableMatrix:
        """∂f/∂x, (q1, n)."""
        return sympy.ImmutableMatrix(len(self.f), len(self.x), lambda i, j: sympy.diff(self.f[i], self.x[j]))
