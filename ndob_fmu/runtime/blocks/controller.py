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
        rows: list[Array] = []
        for name in self.regulated:
            if name in eq.states:
                rows.append(unit[eq.states.index(name)])
            else:
                rows.append(eq.linear_part(self.parameters).C[eq.outputs.index(name)])
        return np.array(rows)

    def start(self) -> Target:
        """Return the equilibrium for references of 0 and nominal disturbances; if there is none, one near x0.

        An empty tank or a shut valve is not a point to linearise at, because an input that enters through f may have no
        effect there. Raises DesignError if there is no equilibrium, or none that the inputs determine.
        """
        eq = self.equations
        n, m, d, x0 = len(eq.states), len(eq.inputs), eq.disturbance_nominal, np.array(eq.x0)
        target = self._equilibrium(Target(x=np.zeros(n), u=np.zeros(m)), np.zeros(m), d)
        for u in _FIRST_INPUTS:
            if target is None:
                target = self._equilibrium(Target(x=x0, u=np.full(m, u)), self.selection @ x0, d)
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
        d = d_hat if self.compensation else self.equations.disturbance_nominal
        found = self._equilibrium(target, np.array(reference), d)
        now = target if found is None else found
        u = now.u - self.gain @ (np.asarray(x_hat) - now.x)
        return now, np.where(self.limit > 0.0, np.maximum(np.minimum(u, self.limit), -self.limit), u)

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

    def _equilibrium(self, guess: Target, reference: Array, d: Vector) -> Target | None:
        n, m, S = len(guess.x), len(guess.u), self.selection
        z = np.concatenate([guess.x, guess.u])
        lower = np.hstack([S, np.zeros((m, m))])
        for _ in range(_ITERATIONS):
            try:
                residual = np.concatenate([self._rates(z, d), S @ z[:n] - reference])
                of_x, of_u = self._jacobians(z[:n], z[n:], d)
                change = np.linalg.solve(np.vstack([np.hstack([of_x, of_u]), lower]), residual)
            except (ArithmeticError, ValueError):  # f has no value or slope there, or J is singular
                return None
            z = z - change
            if not np.isfinite(z).all():
                return None
            if np.max(np.abs(change)) <= _TOLERANCE * (1.0 + np.max(np.abs(z))):
                return Target(x=z[:n], u=z[n:])
        return None

    def _rates(self, z: Array, d: Vector) -> Array:
        n, values = len(self.equations.states), z.tolist()
        return np.array(self.equations.derivatives(values[:n], values[n:], d, self.parameters), dtype=float)

    def _jacobians(self, x: Array, u: Array, d: Vector) -> tuple[Array, Array]:
        eq, p = self.equations, self.parameters
        n, m, q = len(x), len(u), len(d)
        of_x = np.array(eq.linearisation(x.tolist(), u.tolist(), d, p), dtype=float).reshape(-1, n + q)
        of_u = np.array(eq.input_slopes(x.tolist(), u.tolist(), d, p), dtype=float).reshape(-1, m)
        return of_x[:n, :n], of_u[:n]
