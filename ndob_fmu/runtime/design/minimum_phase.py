"""The transmission zeros of the plant, all of which the observer needs left of a margin (eqs. 4 and 21)."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import AssumptionError
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.zeros import AXIS_TOLERANCE, ComplexArray, balance, pencil_zeros


def transmission_zeros(linear: LinearPart) -> ComplexArray:
    """Return the finite transmission zeros of (A, G, C) in 1/s, the one farthest to the right first.

    Raises AssumptionError where the system is degenerate: then every z is a zero.
    """
    return _zeros_and_rate(linear)[0]


def margins_of(zeros: ComplexArray, rate: float) -> Array:
    """Return how far (1/s) zeros lie left of the imaginary axis, less what rounding may hide; rate (1/s): the plant's.

    A zero on the axis has a negative margin, so that the last bits do not decide.
    """
    return np.asarray(-zeros.real - AXIS_TOLERANCE * np.maximum(abs(zeros), rate))


def require_zeros_left_of(linear: LinearPart, margin: float) -> None:
    """Raise AssumptionError unless every zero has Re z < −margin (1/s); the parameters of an FMU may move them."""
    zeros, rate = _zeros_and_rate(linear)
    if np.any(margins_of(zeros, rate) <= margin):
        raise AssumptionError.report(
            "transmission zeros",
            expected=f"all of them left of {-margin:g} 1/s",
            received=f"one at {zeros[0]:.6g} 1/s",
            likely="alpha too large, or parameters that make the plant non-minimum phase",
        )


def _zeros_and_rate(linear: LinearPart) -> tuple[ComplexArray, float]:
    system = balance(linear.A, linear.G, linear.C)
    zeros, rank = pencil_zeros(system.A, system.G, system.C)
    q = linear.G.shape[1]
    if rank < q:
        raise AssumptionError.report(
            "transmission zeros",
            expected=f"{q} unknown inputs that the {len(linear.C)} outputs tell apart",
            received=f"a transfer matrix of normal rank {rank}",
            likely="p < q, an unknown input that reaches no output, or two that reach the outputs in the same way",
        )
    return system.rate * zeros, system.rate
