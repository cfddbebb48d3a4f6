"""The fixed-step master: carries values between components and records them."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import ExitStack

import numpy as np
from tqdm import tqdm

from ndob_fmu.cosim.clock import Clock
from ndob_fmu.cosim.component import Array
from ndob_fmu.cosim.exchange import exchange
from ndob_fmu.cosim.interrupt import deferred_interrupt
from ndob_fmu.cosim.schemes import SCHEMES
from ndob_fmu.cosim.wiring import Wiring
from ndob_fmu.errors import NdobError, UsageError, one_of
from ndob_fmu.results import Recording

_QUIET_SECONDS = 2.0  # a run shorter than this shows no progress bar


def run(wiring: Wiring, clock: Clock, *, scheme: str, progress: bool | None) -> Recording:
    """Run the coupled system over the clock's grid and return its outputs, one row per recorded point, t₀ included.

    scheme: a key of ``SCHEMES``; in each, inputs are held during a step, and an input file's row is that of the
    step's beginning. progress: True shows a bar on stderr, False never does, None does if stderr is a terminal.
    Every component is closed on the way out, whatever happens. Raises UsageError for an unknown scheme or a recording
    that does not fit in memory, and what the components raise.
    """
    if scheme not in SCHEMES:
        raise UsageError.report("scheme", expected=one_of("scheme", SCHEMES, scheme), received=repr(scheme))
    play = wiring.table.player(clock)
    width = len(wiring.names)
    bus = np.zeros(width + len(wiring.table.ports))
    recorded, from_file = bus[:width], bus[width:]
    time, columns = _allocate(clock, width)
    parts = SCHEMES[scheme].parts(wiring.lanes, bus, clock)
    advance = SCHEMES[scheme].advance
    with deferred_interrupt() as check_interrupt, ExitStack() as release:
        for lane in wiring.lanes:
            release.callback(lane.component.close)
            stop_time = clock.time(clock.steps)
            lane.component.setup(clock.start_time, stop_time, lane.start_values, lane.inputs)
        play(0, from_file)
        exchange(parts, bus, wiring)
        for part in parts:
            part.component.initialize()
        for part in parts:
            part.send()
        columns[0] = recorded
        for k in _counted(clock.steps, progress):
            check_interrupt()
            if from_file.size:
                play(k, from_file)
            advance(parts, clock, k)
            if (k + 1) % clock.stride == 0:
                columns[(k + 1) // clock.stride] = recorded
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
