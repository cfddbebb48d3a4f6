"""The integrator of plant and prediction: Dormand and Prince's method of order 5, at rounding-level tolerance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ndob_fmu.runtime.errors import IntegrationError
from ndob_fmu.runtime.riccati import Array

_RELATIVE_TOLERANCE = 1e-11
_ABSOLUTE_TOLERANCE = 1e-12
_MOST_SUBSTEPS = 100_000

# Dormand and Prince, RK5(4)7M: nodes, stages, and the weights of the error estimate.
_C = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
_A = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_E = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


@np.errstate(over="ignore", invalid="ignore")  # what leaves the finite numbers ends in an error below, not in a warning
def integrate(
    derivatives: Callable[[float, Array], Array], x: Array, t: float, t_end: float, h: float
) -> tuple[Array, float]:
    """Return x (n,) at t_end of x' = derivatives(t, x) from x at t, and the substep to try next; h is the one to try.

    Raises IntegrationError where the solution leaves the finite numbers or needs too small substeps.
    """
    # At a jump of the right-hand side in time t_end already has the new value; the last stage needs the old one.
    last_inside = np.nextafter(t_end, t)
    for _ in range(_MOST_SUBSTEPS):
        remaining = t_end - t
        final = h >= remaining * (1.0 - 1e-12)
        step = remaining if final else h
        K = np.empty((7, len(x)))
        try:
            K[0] = derivatives(t, x)
            for i in range(1, 7):
                stage = x + step * (K[:i].T @ _A[i, :i])
                K[i] = derivatives(min(t + _C[i] * step, last_inside), stage)
        except (ArithmeticError, ValueError) as error:
            raise IntegrationError(f"model at t = {t:g} s: its equations cannot be evaluated ({error})") from error
        error_norm = float(
            np.max(np.abs(step * (_E @ K)) / (_ABSOLUTE_TOLERANCE + _RELATIVE_TOLERANCE * np.abs(stage)), initial=0.0)
        )
        if not np.isfinite(error_norm):
            raise IntegrationError(f"model at t = {t:g} s: the solution leaves the finite numbers")
        grow = min(5.0, max(0.2, 0.9 * error_norm**-0.2)) if error_norm > 0.0 else 5.0
        if error_norm > 1.0:
            h = step * min(grow, 0.9)
            continue
        x, t = stage, t + step
        if final:
            # A step cut short by the end of the interval says little against the longer one that was planned.
            return x, max(h, step * grow)
        h = step * grow
    raise IntegrationError(
        f"model at t = {t:g} s: more than {_MOST_SUBSTEPS} substeps in one communication step; "
        "likely cause: parameters that make the plant stiff or unstable"
    )
