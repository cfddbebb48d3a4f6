"""The integrator of plant and prediction where the explicit one would need many substeps: an exponential method.

exprb43 of Hochbruck, Ostermann and Schweitzer (2009), of order 4 with an error of order 3. With z = [x; t], M = ∂ż/∂z,
D_i = ż(Z_i) − ż(z) − M (Z_i − z), and φ_k of h M where nothing else is said:

    Z₂ = z + ½ h φ₁(½ h M) ż
    Z₃ = z + h φ₁ (ż + D₂)
    z(h) = z + h φ₁ ż + h φ₃ (16 D₂ − 2 D₃) + ε,   ε = h φ₄ (12 D₃ − 48 D₂)

It is exact for ẋ = A x + (a polynomial of degree 3 in t), and ε = 0 up to degree 2. So it is stable for each stable
mode: neither a fast decay nor a fast oscillation limits the substep, only what is not linear.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from math import inf, isfinite

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.integrate import ABSOLUTE_TOLERANCE, adapt, adapt_in_few, cash_karp, cut
from ndob_fmu.runtime.numerics.phi import phi_functions
from ndob_fmu.runtime.numerics.sliding import Derivatives, Surfaces, slide

# Of the error of order 3; that of the result is smaller by more than ten.
RELATIVE_TOLERANCE = 1e-7
# In one communication step; 0.2 s. An explicit method is cheaper where the solution itself is that lively.
MOST_SUBSTEPS = 1000
# In parts of the communication step: at a jump of the right-hand side no substep is short enough.
_SHORTEST = 1e-13
# How often surfaces may hold x and let it go in one communication step.
_MOST_STOPS = 8

# slopes(t, x) returns ∂ẋ/∂x (n,n) and ∂ẋ/∂t (n,).
Slopes = Callable[[float, Array], tuple[Array, Array]]


@np.errstate(over="ignore", invalid="ignore")  # what leaves the finite numbers ends in an error, not in a warning
def integrate_any(
    derivatives: Derivatives,
    slopes: Slopes,
    surfaces: Surfaces,
    x: Array,
    t_end: float,
    h: float,
    t: float = 0.0,
) -> tuple[Array, float]:
    """Return x (n,) at t_end of x' = derivatives(t, x) from x at t, and the explicit substep to try next.

    surfaces: those at which x' jumps, as `sliding` takes them; x has come to one where t > 0
    h: the explicit substep to try first. It stays where the explicit method would need too many.

    Raises IntegrationError where the solution leaves the finite numbers or needs too small substeps.
    """
    last_inside = float(np.nextafter(t_end, 0.0))

    def trial(t: float, x: Array, step: float) -> tuple[Array, float]:
        return cash_karp(derivatives, last_inside, t, x, step)

    planned = h
    for _ in range(_MOST_STOPS if len(surfaces(x)) else 0):
        came = t
        x, t = slide(derivatives, surfaces, x, came, t_end, t_end if came > 0.0 else 0.0)
        if t == t_end:
            return x, h
        # Where x has not come to the surface yet, or goes through it, the substeps go on as they were.
        reached = adapt_in_few(trial, x, t, t_end, planned if t == came else h, stops=True)
        if reached is None:
            break
        x, t, planned = reached
        if t == t_end:
            return x, planned
    explicit = adapt_in_few(trial, x, t, t_end, h, stops=False)
    if explicit is not None:
        return explicit[0], explicit[2]
    after = integrate_stiff(derivatives, slopes, x, t_end, t)
    return adapt(trial, x, t, t_end, h) if after is None else (after, h)


@np.errstate(over="ignore", invalid="ignore")  # what leaves the finite numbers makes the substep shorter
def integrate_stiff(derivatives: Derivatives, slopes: Slopes, x: Array, t_end: float, t: float = 0.0) -> Array | None:
    """Return x (n,) at t_end of x' = derivatives(t, x) from x at t; None where too many substeps would be needed.

    Where the slopes have no value they are taken to be 0, which makes the substep an explicit one.
    """
    n, h, shortest = len(x), t_end - t, _SHORTEST * (t_end - t)
    z = np.append(x, t)
    last_inside = np.nextafter(t_end, t)  # at a jump in time t_end already has the new value

    def rate(z: Array) -> Array:
        return np.append(derivatives(min(float(z[n]), last_inside), z[:n]), 1.0)

    def slope(z: Array) -> Array:
        M = np.zeros((n + 1, n + 1))
        with suppress(ArithmeticError, ValueError):
            M[:n, :n], M[:n, n] = slopes(float(z[n]), z[:n])
        return M

    for _ in range(MOST_SUBSTEPS):
        left = t_end - float(z[n])
        h = cut(h, left)
        if not h >= shortest:
            return None
        after, error_norm = _trial(rate, slope(z), z, h)
        if error_norm <= 1.0:
            z = after
            if h == left:
                return z[:n]
        h *= _growth(error_norm)
    return None


def _trial(rate: Callable[[Array], Array], M: Array, z: Array, h: float) -> tuple[Array, float]:
    """Return z a substep h later, and the norm of its error, infinite where it has no value."""
    try:
        half, phi = phi_functions(h * M)
        start = rate(z)
        linear = h * (phi[1] @ start)

        def left_out(change: Array) -> Array:
            return np.asarray(rate(z + change) - start - M @ change)

        D_2 = left_out(0.5 * h * (half @ start))
        D_3 = left_out(linear + h * (phi[1] @ D_2))
    except (ArithmeticError, ValueError):
        return z, inf
    error = h * (phi[4] @ (12.0 * D_3 - 48.0 * D_2))
    after = z + linear + h * (phi[3] @ (16.0 * D_2 - 2.0 * D_3)) + error
    tolerated = ABSOLUTE_TOLERANCE + RELATIVE_TOLERANCE * np.maximum(np.abs(z), np.abs(after))
    error_norm = float(np.max(np.abs(error[:-1]) / tolerated[:-1]))
    return after, error_norm if isfinite(error_norm) else inf


def _growth(error_norm: float) -> float:
    return min(5.0, max(0.1, 0.9 * error_norm**-0.25)) if error_norm > 0.0 else 5.0
