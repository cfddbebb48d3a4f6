"""The exchange of values during initialization, until they are consistent."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.cosim.master.schemes import Part
from ndob_fmu.cosim.system.loops import algebraic_loops
from ndob_fmu.cosim.system.wiring import Wiring
from ndob_fmu.errors import some_of
from ndob_fmu.runtime.arrays import Array

_log = logging.getLogger(__name__)
_MOST_ITERATIONS = 100
_MEMORY = 20  # as many signals of a linear loop are solved at once; more take more iterations
_TOLERANCE = 1e-10  # of a value; far below what a step adds, far above rounding
_ROUNDING = 1e-14  # of the signal's largest value so far, for a signal that converges to zero


def exchange(parts: Sequence[Part], bus: Array, wiring: Wiring) -> None:
    """Carry outputs to inputs, components being in initialization mode, until nothing changes any more.

    Without an algebraic loop, the first sweep brings in the input file, and each sweep settles at least one more
    connection; the last one shows that nothing changes. A value that still changes then is part of a loop, which is
    iterated until it converges. A warning names a loop that does not.
    """
    for part in parts:
        part.send()
    start = bus.copy()
    for _ in range(wiring.links + bool(wiring.table.ports) + 1):
        before = bus.copy()
        _sweep(parts)
        if np.array_equal(before, bus, equal_nan=True):
            return
    width = len(wiring.names)
    real = np.array([kind == "Real" for kind in wiring.types])
    moving = np.flatnonzero((before != bus)[:width] & real)
    bus[moving] = start[moving]  # the sweeps of a loop with a gain above one diverge
    if not _iterate(parts, bus, moving):
        names = {wiring.names[index] for index in np.flatnonzero((before != bus)[:width])}
        _warn(wiring, names)


def _sweep(parts: Sequence[Part]) -> None:
    for part in parts:
        part.receive(0)
        part.send()


def _iterate(parts: Sequence[Part], bus: Array, moving: NDArray[np.intp]) -> bool:
    """Iterate the values at ``moving`` by Anderson's method, which also solves loops with a gain above one.

    Of the last sweeps x → g it takes the combination whose residual g − x is least; in a linear loop that is the
    solution, after one sweep more than the loop has signals. Returns whether a sweep has changed nothing.
    """
    x = bus[moving]
    largest = np.abs(x)
    images: list[Array] = []
    residuals: list[Array] = []
    for _ in range(_MOST_ITERATIONS):
        others = bus.copy()
        bus[moving] = x
        _sweep(parts)
        g = bus[moving]
        residual = g - x
        if not np.isfinite(residual).all():
            return False
        size = np.maximum(np.abs(x), np.abs(g))
        largest = np.maximum(largest, size)
        others[moving] = g
        settled = (np.abs(residual) <= _TOLERANCE * size + _ROUNDING * largest).all()
        if settled and np.array_equal(others, bus, equal_nan=True):
            return True
        images, residuals = [*images[-_MEMORY:], g], [*residuals[-_MEMORY:], residual]
        x = g
        if len(images) > 1 and x.size:
            # Scaled, since signals have different units.
            unit = np.where(largest > 0, largest, 1.0)
            steps = np.column_stack([residual - old for old in residuals[:-1]]) / unit[:, None]
            weights = np.linalg.lstsq(steps, residual / unit, rcond=None)[0]
            x = g - np.column_stack([g - old for old in images[:-1]]) @ weights
    return False


def _warn(wiring: Wiring, unsettled: set[str]) -> None:
    loops = [
        loop for loop in algebraic_loops(wiring.system, initial=True) if not unsettled.isdisjoint(map(str, loop.ports))
    ]
    _log.warning(
        "the values at the start do not settle: %s; the first steps begin from values that do not fit together",
        f"algebraic loop {some_of(map(str, loops), between='; ')}"
        if loops
        else f"{some_of(sorted(unsettled))} change whenever they are read",
    )
