"""The transmission zeros of the plant, all of which the observer needs left of a margin (eqs. 4 and 21)."""

from __future__ import annotations

from ndob_fmu.runtime.base_errors import AssumptionError
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.zeros import ComplexArray, balance, pencil_zeros


def transmission_zeros(linear: LinearPart) -> ComplexArray:
    """Return the finite transmission zeros of (A, G, C) in 1/s, the one farthest to the right first.

    Raises AssumptionError where the system is degenerate: then every z is a zero.
    """
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
    return system.rate * zeros


def require_zeros_left_of(linear: LinearPart, margin: float) -> None:
    """Raise AssumptionError unless every zero has Re z < −margin (1/s); the parameters of an FMU may move them."""
    zeros = transmission_zeros(linear)
    if len(zeros) and zeros[0].real >= -margin:
        raise AssumptionError.report(
            "transmission zeros",
            expected=f"all of them left of {-margin:g} 1/s",
            received=f"one at {zeros[0]:.6g} 1/s",
            likely="alpha too large, or parameters that make the plant non-minimum phase",
        )
