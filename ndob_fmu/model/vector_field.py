"""The right-hand side of a model, ẋ and y, and ∂f/∂x: put together here once, for code, pages and checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy

from ndob_fmu.model.affine_split import AffineSplit

Symbols = tuple[sympy.Symbol, ...]
Expressions = tuple[sympy.Expr, ...]


@dataclass(frozen=True)
class VectorField:
    """ẋ = F(x, u) + G_d w, y = h(x, u) in symbols, with what is constant in F and h apart.

        F = A x + B u + G_f f(x, u),   h = C x + g(x, u),   w = d, or w = n(x, u) d with a channel

    In the paper's form G_d is constant and g = 0.

    x: states (n,)
    u: inputs (m,)
    d: disturbances (q2,)
    p: parameters
    parts: the matrices, f, n and g
    """

    x: Symbols
    u: Symbols
    d: Symbols
    p: Symbols
    parts: AffineSplit

    @property
    def f(self) -> Expressions:
        """f (q1,)."""
        return self.parts.f

    @property
    def G_d(self) -> sympy.ImmutableMatrix:
        """G_d (n,k)."""
        return self.parts.G_d

    @property
    def direction(self) -> Expressions:
        """n (k,) of the channel; empty without one."""
        return self.parts.direction

    @cached_property
    def drift(self) -> Expressions:
        """F (n,), ẋ without disturbance."""
        total = self.parts.A * sympy.Matrix(self.x)
        if self.u:
            total += self.parts.B * sympy.Matrix(self.u)
        if self.f:
            total += self.parts.G_f * sympy.Matrix(self.f)
        return tuple(total)

    def derivatives(self, w: Sequence[sympy.Expr]) -> Expressions:
        """Return ẋ (n,) for one expression w for each column of G_d."""
        return tuple(sympy.Matrix(self.drift) + self.G_d * sympy.Matrix(w))

    def driven_by(self, d: Sequence[sympy.Expr]) -> Expressions:
        """Return w, what acts through the columns of G_d, for the disturbances d (q2,)."""
        return tuple(n * d[0] for n in self.direction) or tuple(d)

    @cached_property
    def outputs(self) -> Expressions:
        """h (p,)."""
        return tuple(self.parts.C * sympy.Matrix(self.x) + sympy.Matrix(self.parts.output_rest))

    @cached_property
    def jacobian(self) -> sympy.ImmutableMatrix:
        """∂f/∂x, (q1, n)."""
        return sympy.ImmutableMatrix(len(self.f), len(self.x), lambda i, j: sympy.diff(self.f[i], self.x[j]))

    @cached_property
    def directions_are_constant(self) -> bool:
        """Whether G_d depends on parameters only."""
        return not (self.G_d.free_symbols & {*self.x, *self.u})

    @cached_property
    def outputs_are_linear(self) -> bool:
        """Whether y = C x."""
        return not any(self.parts.output_rest)

    @cached_property
    def jumps_at(self) -> Expressions:
        """The functions g(x, u) of states at whose zeros ẋ may jump: arguments of signs and sides of conditions."""
        found: list[sympy.Expr] = []
        for rate in self.derivatives(self.driven_by(self.d)):
            steps = [step.args[0] for step in rate.atoms(sympy.sign, sympy.Heaviside)]
            for g in [*steps, *(side.lhs - side.rhs for side in rate.atoms(sympy.core.relational.Relational))]:
                within = g.free_symbols
                known = any(sympy.simplify(g - one) == 0 or sympy.simplify(g + one) == 0 for one in found)
                if within & {*self.x} and not within & {*self.d} and not known:
                    found.append(g)
        return tuple(sorted(found, key=str))

    @property
    def feedthrough(self) -> tuple[tuple[int, ...], ...]:
        """For each output the indices of the inputs that it depends on directly."""
        return tuple(
            tuple(i for i, symbol in enumerate(self.u) if symbol in output.free_symbols) for output in self.outputs
        )

    @property
    def has_paper_form(self) -> bool:
        """Whether A, B, C, G_f, G_d, f and a channel say all: what method 1 and the paper's assumptions need."""
        return self.directions_are_constant and self.outputs_are_linear

    @cached_property
    def not_linear(self) -> frozenset[sympy.Symbol]:
        """The states and inputs that f, n, g or G_d depend on."""
        parts = [*self.f, *self.direction, *self.parts.output_rest, *self.G_d]
        return frozenset().union(*(part.free_symbols for part in parts)) & {*self.x, *self.u}

    @cached_property
    def nonlinear_states(self) -> tuple[int, ...]:
        """Indices of the states that f, g or G_d change with."""
        varying = [*self.f, *self.parts.output_rest, *self.G_d]
        return tuple(j for j, state in enumerate(self.x) if any(sympy.diff(part, state) != 0 for part in varying))
