"""The controller: state feedback to the equilibrium at the references, for the estimated disturbance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.equations import Equations, Vector

_TOLERANCE = 1e-9
_ITERATIONS = 30
# Start values of Newton's method for the inputs that hold x0, whose size is unknown.
_FIRST_INPUTS = (0.0, *(sign * 10.0**k for k in (0, -1, 1, -2, 2, -3, 3, -4, 4, -5, 5, -6, 6) for sign in (1.0, -1.0)))


@dataclass(frozen=True)
class Feedback:
    """What a controller is built with besides its plant.

    regulated: the m states or outputs that follow references
    gain: K (m,n) as nested tuples
    """

    regulated: tuple[str, ...]
    gain: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Target:
    """x* (n,) and u* (m,): the equilibrium with the regulated outputs at their references."""

    x: Array
    u: Array


@dataclass(frozen=True)
class Controller:
    """State feedback to the equilibrium x*, u*, which is kept from step to step as Newton's first guess only.

        0 = A x* + B u* + G_f f(x*, u*) + G_d d̂,   S x* = r          equilibrium, solved by Newton's method
        u = u* − K (x̂ − x*),   |u| ≤ limit

    Where d acts through the inputs' channel (G_d = B Γ), x* does not depend on d̂ and u* contains −Γ d̂: the compensation
    is exact at any pace. Elsewhere it is exact for the regulated outputs once d̂ is constant.

    regulated: the m states or outputs that follow references; each is a row of S (m,n)
    gain: K (m,n)
    limit (m,): of each |u|; 0 for no limit
    compensation: whether d̂ counts; otherwise it is taken to be nominal
    """

    equations: Equations
    parameters: Vector
    regulated: Sequence[str]
    gain: Array
    limit: Array
    compensation: bool

    @cached_property
    def selection(self) -> Array:
        """S (m,n)."""
        eq = self.equations
        unit = np.eye(len(eq.states))

        def row(name: str) -> Array:
            if name in eq.states:
                return np.asarray(unit[eq.states.index(name)])
            return np.asarray(eq.linear_part(self.parameters).C[eq.outputs.index(name)], dtype=float)

        return np.array([row(name) for name in self.regulated])

    def start(self) -> Target:
        """Return the equilibrium for references of 0 and nominal disturbances; if there is none, one near x0.

        An empty tank or a shut valve is not a point to linearise at, because an input that enters through f may have no
        effect there. Raises DesignError if there is no equilibrium, or none that the inputs determine.
        """
        eq = self.equations
        d, x0 = list(eq.disturbance_nominal), np.array(eq.x0)
        guess = Target(x=np.zeros(len(eq.states)), u=np.zeros(len(eq.inputs)))
        target = self._equilibrium(guess, [0.0] * len(self.selection), d)
        for u in _FIRST_INPUTS:
            target = target or self._equilibrium(Target(x=x0, u=np.full(len(eq.inputs), u)), self.selection @ x0, d)
        if target is None:
            raise DesignError.report(
                f"the rest position of {eq.name}",
                expected="one that the inputs can hold, for references of 0 or of x0",
                received="none",
                likely="the regulated outputs integrate, or the inputs have no lasting effect on them",
            )
        return target

    def step(self, target: Target, reference: Vector, x_hat: Vector, d_hat: Vector) -> tuple[Target, Array]:
        """Return the equilibrium for the references (m,) and d̂ (q2,), and u (m,).

        If Newton's method does not converge, the equilibrium of the step before is kept.
        """
        d = list(d_hat if self.compensation else self.equations.disturbance_nominal)
        target = self._equilibrium(target, reference, d) or target
        u = target.u - self.gain @ (np.asarray(x_hat) - target.x)
        return target, np.where(self.limit > 0.0, np.clip(u, -self.limit, self.limit), u)

    def possible(self, target: Target) -> bool:
        """Return whether numbers in the form of a target can be one."""
        return bool(np.isfinite(target.x).all() and np.isfinite(target.u).all())

    def saturates(self, u: Array) -> bool:
        """Whether a command (m,) is at its limit."""
        return bool(np.any((self.limit > 0.0) & (np.abs(u) >= self.limit)))

    def jacobians(self, target: Target) -> tuple[Array, Array]:
        """Return ∂ẋ/∂x (n,n) and ∂ẋ/∂u (n,m) at the target with nominal disturbances.

        Raises DesignError where f has no slope.
        """
        try:
            return self._jacobians(target.x, target.u, self.equations.disturbance_nominal)
        except (ArithmeticError, ValueError) as error:
            raise DesignError.report(
                f"the linearisation of {self.equations.name} at its rest position",
                expected="finite slopes of f",
                received=str(error),
                likely="a root of 0, as of an orifice without flow: start from an x0 with flow",
            ) from error

    def _equilibrium(self, guess: Target, reference: Vector, d: Sequence[float]) -> Target | None:
        n, m = len(guess.x), len(guess.u)
        z = np.concatenate([guess.x, guess.u])
        lower = np.hstack([self.selection, np.zeros((m, m))])
        for _ in range(_ITERATIONS):
            residual = np.concatenate([self._rates(z, d), self.selection @ z[:n] - reference])
            try:
                J = np.vstack([np.hstack(self._jacobians(z[:n], z[n:], d)), lower])
                change = np.linalg.solve(J, residual)
            except (ArithmeticError, ValueError):  # f has no slope there, or J is singular
                return None
            z = z - change
            if not np.isfinite(z).all():
                return None
            if np.max(np.abs(change)) <= _TOLERANCE * (1.0 + np.max(np.abs(z))):
                return Target(x=z[:n], u=z[n:])
        return None

    def _rates(self, z: Array, d: Sequence[float]) -> Array:
        n, values = len(self.equations.states), z.tolist()
        return np.array(self.equations.derivatives(values[:n], values[n:], d, self.parameters), dtype=float)

    def _jacobians(self, x: Array, u: Array, d: Vector) -> tuple[Array, Array]:
        eq, at = self.equations, (x.tolist(), u.tolist(), d, self.parameters)
        n, m, q = len(x), len(u), len(d)
        of_x = np.array(eq.linearisation(*at), dtype=float).reshape(-1, n + q)[:n, :n]
        return of_x, np.array(eq.input_slopes(*at), dtype=float).reshape(-1, m)[:n]
