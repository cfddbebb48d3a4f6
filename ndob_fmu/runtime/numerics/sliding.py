"""Motion along surfaces g(x) = 0 at which x' = f(t, x) jumps, as of a mass that dry friction holds (Filippov, 1988).

Where f points to a surface from both sides, f₋ on the side g < 0 and f₊ on the other, x stays on it and moves by the
mean of both that leaves g at 0. With the normals N = ∂g/∂x of the surfaces that hold x, and Δ = f₊ − f₋ for each:

    f = f₋ + Δ α,   N f = 0,   0 < α < 1

An error of x across the surfaces is gone on arrival, and what else moves x across them has no effect:

    Π = I − Δ (N Δ)⁻¹ N,   x̃ ← Π x̃,   x̃' = Π (∂f/∂x) x̃
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.integrate import integrate

Derivatives = Callable[[float, Array], Array]
# surfaces(x) returns [g, ∂g/∂x] (k,1 + n).
Surfaces = Callable[[Array], Array]

# x is on a surface where g is 0 but for rounding: in parts of what the states make of it. It arrives where f would
# bring it there in such a part of the interval.
_ROUNDING, _ARRIVED = 1e-12, 1e-6
_LEAST = 1e-150
# How often the time is halved in which x leaves a surface.
_HALVINGS = 40


class Sliding(NamedTuple):
    """How x lies to the surfaces that it is on.

    x (n,): on those that hold it, and just beside the others, on the side to which it leaves
    held: the rows of `surfaces` that hold x
    normals (h,n): N
    jumps (n,h): Δ
    below (n,): f₋
    shares (h,): α
    apart (n,h): ways from the surfaces to beside them
    """

    x: Array
    held: Sequence[int]
    normals: Array
    jumps: Array
    below: Array
    shares: Array
    apart: Array

    @property
    def rate(self) -> Array:
        """f (n,), along the surfaces."""
        return np.asarray(self.below + self.jumps @ self.shares)

    @property
    def holds(self) -> bool:
        """Whether f points to all of these surfaces from both sides."""
        across = (self.normals * self.jumps.T).sum(axis=1)
        return bool(np.all((across < 0.0) & (self.shares >= 0.0) & (self.shares <= 1.0)))

    @property
    def projection(self) -> Array:
        """Π (n,n)."""
        across = np.linalg.solve(self.normals @ self.jumps, self.normals)
        return np.asarray(np.eye(len(self.x)) - self.jumps @ across)


def sliding(f: Callable[[Array], Array], surfaces: Surfaces, x: Array, interval: float = 0.0) -> Sliding | None:
    """Return how x (n,) lies to the surfaces that it is on, or would reach in a millionth of an interval (s).

    None where it is on none of them.
    """
    table = surfaces(x)
    normals = table[:, 1:]
    room = rounding(normals, x)
    if interval > 0.0:
        room = room + _ARRIVED * interval * (np.abs(normals) @ np.abs(f(x)))
    on = _within(table, room)
    return released(beside(f, table, x, on)) if on else None


def no_surfaces(x: Array) -> Array:
    """Return what `Surfaces` does for x' without jumps."""
    return np.zeros((0, 1 + len(x)))


def all_on(table: Array, x: Array) -> list[int]:
    """Return which surfaces with [g, ∂g/∂x] (k,1 + n) x (n,) is on, but for rounding."""
    return _within(table, rounding(table[:, 1:], x))


def _within(table: Array, room: Array) -> list[int]:
    return [i for i in range(len(table)) if abs(float(table[i, 0])) <= float(room[i])]


def rounding(normals: Array, x: Array) -> Array:
    """Return how far from 0 rounding of x (n,) may take each g (k,)."""
    return np.asarray(_ROUNDING * (np.abs(normals) @ np.abs(x)) + _LEAST)


def beside(f: Callable[[Array], Array], table: Array, x: Array, on: Sequence[int]) -> Sliding:
    """Return how x (n,) lies to the surfaces `on` if all of them hold it."""
    rows = table[list(on)]
    g, normals = rows[:, 0], rows[:, 1:]
    across = np.linalg.pinv(normals)
    room = 2.0 * rounding(normals, x)
    at = x - across @ g
    lowest = at - across @ room
    below = f(lowest)
    jumps = np.zeros((len(x), len(on)))
    for j in range(len(on)):
        jumps[:, j] = f(lowest + 2.0 * room[j] * across[:, j]) - below
    return Sliding(at, on, normals, jumps, below, _shares(normals, jumps, below), across * room)


def _shares(normals: Array, jumps: Array, below: Array) -> Array:
    return np.asarray(np.linalg.lstsq(normals @ jumps, -(normals @ below), rcond=None)[0])


def released(here: Sliding) -> Sliding:
    """Return how x lies to its surfaces, without those that do not hold it."""
    while len(here.held) and not here.holds:
        # Where f does not point to a surface from both sides, it takes x away from it, or through it.
        across = (here.normals * here.jumps.T).sum(axis=1)
        outside = np.where(across < 0.0, np.abs(here.shares - 0.5), np.inf)
        worst = int(np.argmax(outside))
        above = bool(here.shares[worst] > 0.5) if across[worst] < 0.0 else bool(here.normals[worst] @ here.below > 0.0)
        rest = [j for j in range(len(here.held)) if j != worst]
        below, x = here.below, here.x - here.apart[:, worst]
        if above:
            below, x = below + here.jumps[:, worst], here.x + here.apart[:, worst]
        normals, jumps = here.normals[rest], here.jumps[:, rest]
        held = [here.held[j] for j in rest]
        here = Sliding(x, held, normals, jumps, below, _shares(normals, jumps, below), here.apart[:, rest])
    return here


def slide(
    derivatives: Derivatives, surfaces: Surfaces, x: Array, t: float, t_end: float, interval: float
) -> tuple[Array, float]:
    """Return x (n,) where surfaces let it go, and that time; x at t_end if they do not, and x at t if none holds it.

    interval: as `sliding` takes it

    Raises IntegrationError as `integrate`.
    """

    def now(x: Array) -> Array:
        return derivatives(t, x)

    here = sliding(now, surfaces, x, interval)
    if here is None:
        return x, t
    if not here.held:
        return here.x, t
    held, start, last_inside = here.held, here.x, float(np.nextafter(t_end, t))

    def along(t: float, x: Array) -> Sliding:
        def at_t(x: Array) -> Array:
            return derivatives(t, x)

        return beside(at_t, surfaces(x), x, held)

    def rate(t: float, x: Array) -> Array:
        return along(t, x).rate

    def after(end: float) -> Sliding:
        moved, _ = integrate(rate, start, t, end, end - t)
        return along(min(end, last_inside), moved)

    there = after(t_end)
    if there.holds:
        return there.x, t_end
    held_until, left = t, t_end
    for _ in range(_HALVINGS):
        middle = 0.5 * (held_until + left)
        if not held_until < middle < left:
            break
        tried = after(middle)
        if tried.holds:
            held_until = middle
        else:
            left, there = middle, tried
    return released(there).x, left
