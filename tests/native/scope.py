"""Which modules of the runtime must translate, and what of them does not yet: this list may only become shorter."""

from __future__ import annotations

MODULES = [
    f"ndob_fmu.runtime.numerics.{name}"
    for name in (
        "exponential",
        "hold",
        "integrate",
        "kalman",
        "phi",
        "riccati",
        "stiff",
        "transition",
        "units",
        "zeros",
    )
]

# Written by hand in C; the tests call these beside their twins too.
BY_HAND = {"numerics.kalman.triangular"}

NOT_YET: dict[str, str] = {}
