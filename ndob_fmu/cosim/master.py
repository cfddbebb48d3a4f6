"""The fixed-step master: carries values between components and records them."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from ndob_fmu.cosim.clock import Clock
from ndob_fmu.cosim.component import Array, Component
from ndob_fmu.cosim.interrupt import deferred_interrupt
from ndob_fmu.cosim.wiring import Wiring
from ndob_fmu.errors import NdobError, UsageError
from ndob_fmu.results import Recording

_log = logging.getLogger(__name__)
_QUIET_SECONDS = 2.0  # a run shorter than this shows no progress bar


@dataclass(frozen=True, eq=False)
class _Part:
    """A component with the stretches of memory that the loop moves values between."""

    component: Component
    sources: NDArray[np.intp]
    inputs: Array
    outputs: Array  # a view of the bus

    def receive(self, bus: Array) -> None:
        if self.inputs.size:
            np.take(bus, self.sources, out=self.inputs, mode="clip")  # any other mode copies through a buffer
            self.component.set_inputs(self.inputs)

    def send(self) -> None:
        if self.outputs.size:
            self.component.get_outputs(self.outputs)


def _jacobi(parts: list[_Part], bus: Array, time: float, step_size: float) -> None:
    """Every component steps with what all the others had at the beginning of the step."""
    for part in parts:
        part.receive(bus)
        part.component.step(time, step_size)
    for part in parts:
        part.send()


def _gauss_seidel(parts: list[_Part], bus: Array, time: float, step_size: float) -> None:
    """Every component steps with what those before it already have at the end of the step."""
    for part in parts:
        part.receive(bus)
        part.component.step(time, step_size)
        part.send()


SCHEMES: dict[str, Callable[[list[_Part], Array, float, float], None]] = {
    "jacobi": _jacobi,
    "gauss-seidel": _gauss_seidel,
}


def run(wiring: Wiring, clock: Clock, *, scheme: str, progress: bool | None) -> Recording:
    """Run the coupled system over the clock's grid and return its outputs, one row per recorded point, t₀ included.

    scheme: a key of ``SCHEMES``; in both, inputs are held during a step, and an input file's row is that of the
    step's beginning. progress: True shows a bar on stderr, False never does, None does if stderr is a terminal.
    Every component is closed on the way out, whatever happens. Raises UsageError for an unknown scheme or a recording
    that does not fit in memory, and what the components raise.
    """
    if scheme not in SCHEMES:
        raise UsageError.report("scheme", expected=" or ".join(SCHEMES), received=repr(scheme))
    play = wiring.table.player(clock)
    width = len(wiring.names)
    bus = np.zeros(width + len(wiring.table.ports))
    from_file = bus[width:]
    time, columns = _allocate(clock, width)
    parts = [
        _Part(lane.component, lane.sources, np.empty(len(lane.inputs)), bus[lane.outputs]) for lane in wiring.lanes
    ]
    advance = SCHEMES[scheme]
    with deferred_interrupt() as check_interrupt, ExitStack() as release:
        for lane in wiring.lanes:
            release.callback(lane.component.close)
            stop_time = clock.time(clock.steps)
            lane.component.setup(clock.start_time, stop_time, lane.start_values, lane.inputs)
        play(0, from_file)
        _exchange(parts, bus, wiring)
        for part in parts:
            part.component.initialize()
        for part in parts:
            part.send()
        columns[0] = bus[:width]
        for k in _counted(clock.steps, progress):
            check_interrupt()
            play(k, from_file)
            advance(parts, bus, clock.time(k), clock.step_size)
            if (k + 1) % clock.stride == 0:
                columns[(k + 1) // clock.stride] = bus[:width]
        check_interrupt()
    return Recording(time, wiring.names, columns, wiring.types)


def _counted(steps: int, progress: bool | None) -> Iterable[int]:
    shown = sys.stderr.isatty() if progress is None else progress
    if not shown:
        return range(steps)  # even a disabled tqdm starts a thread, which a later fork would warn about
    bar: Iterable[int] = tqdm(range(steps), delay=_QUIET_SECONDS, unit="step", leave=False)
    return bar


def _allocate(clock: Clock, width: int) -> tuple[Array, Array]:
    recorded = clock.steps // clock.stride + 1
    try:
        # The same expression as Clock.time, so that the two agree to the last bit.
        time = np.float64(clock.start_time) + np.arange(recorded) * clock.stride * clock.step_size
        return time, np.empty((recorded, width))
    except (MemoryError, ValueError, OverflowError) as error:
        raise _too_long(recorded, width) from error


def _too_long(rows: int, width: int) -> NdobError:
    return UsageError.report(
        "recording",
        expected="one that fits in memory",
        received=f"{rows} rows of {width} signals",
        likely="the step size is far too small; a larger output interval records less",
    )


def _exchange(parts: list[_Part], bus: Array, wiring: Wiring) -> None:
    """Carry outputs to inputs during initialization until nothing changes any more.

    Without an algebraic loop the first sweep brings in the input file and each one settles at least one connection
    more, so that one sweep besides shows that nothing changes.
    """
    sweeps = wiring.links + bool(wiring.table.ports) + 1
    for part in parts:
        part.send()
    for _ in range(sweeps):
        before = bus.copy()
        for part in parts:
            part.receive(bus)
            part.send()
        if np.array_equal(before, bus, equal_nan=True):
            return
    names = [name for name, old, new in zip(wiring.names, before, bus, strict=False) if old != new]
    _log.warning(
        "the values at the start have not settled after %d exchanges: algebraic loop through %s; the first steps "
        "begin from values that do not fit together",
        sweeps,
        ", ".join(names),
    )
