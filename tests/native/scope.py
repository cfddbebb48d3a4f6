"""Which modules of the runtime must translate, and what of them does not yet: this list may only become shorter."""

from __future__ import annotations

MODULES = [
    f"ndob_fmu.runtime.numerics.{name}"
    for name in ("exponential", "hold", "integrate", "kalman", "phi", "riccati", "stiff", "transition", "zeros")
]

# Written by hand in C; the tests call these beside their twins too.
BY_HAND = {"numerics.kalman.triangular"}

NOT_YET = {
    "numerics.hold.History.with_sample": "a slice with a step",
    "numerics.integrate._adapt": "generic in the type of x, and errors as results",
    "numerics.integrate.adapt": "as _adapt",
    "numerics.integrate.adapt_in_few": "as _adapt",
    "numerics.integrate.cash_karp": "returns a function",
    "numerics.integrate.integrate": "as _adapt",
    "numerics.riccati._principal_axes": "* in a call",
    "numerics.riccati._settle_scale": "* in a call",
    "numerics.riccati._solve_scaled": "complex eigenvalues",
    "numerics.riccati.solve_riccati": "a generator",
    "numerics.riccati.solve_riccati_over": "a generator",
    "numerics.stiff.integrate_any": "as integrate._adapt",
    "numerics.zeros.pencil_zeros": "complex eigenvalues",
}
