"""The fixed-step master: carries values between components and records them."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import ExitStack

import numpy as np

from ndob_fmu.cosim.component import Component
from ndob_fmu.cosim.master.exchange import exchange
from ndob_fmu.cosim.master.progress_bar import tqdm
from ndob_fmu.cosim.master.rows import Rows
from ndob_fmu.cosim.master.schemes import SCHEMES, Ending, earliest
from ndob_fmu.cosim.system.wiring import Wiring
from ndob_fmu.cosim.time_grid import TimeGrid
from ndob_fmu.errors import UsageError, one_of
from ndob_fmu.results.recording import Recording
from ndob_fmu.support.interrupts import deferred_interrupt, held

QUIET_SECONDS = 2.0  # a run shorter than this shows no progress bar


def run(wiring: Wiring, grid: TimeGrid, *, scheme: str, progress: bool | None, tolerance: float | None) -> Recording:
    """Run the coupled system over the time grid and return its outputs, one row per recorded point, t₀ included.

    scheme: a key of ``SCHEMES``; in each, inputs are held during a step, and an input file's row is that of the
        step's beginning.
    progress: True shows a bar on stderr, False never does, None does if stderr is a terminal.
    tolerance: relative, for all components; None leaves it to each of them.

    A component that ends the simulation ends the run. The last row is then at that time, and the other components have
    in it the values of the communication point before. Every component is closed at the end, after an error too.
    Raises UsageError for an unknown scheme or a recording that does not fit in memory, and what the components raise;
    a SimulationError carries the rows that were recorded before it.
    """
    if scheme not in SCHEMES:
        raise UsageError.report("scheme", expected=one_of("scheme", SCHEMES, scheme), received=repr(scheme))
    play = wiring.table.player(grid)
    width = len(wiring.names)
    bus = np.zeros(width + len(wiring.table.ports))
    recorded, from_file = bus[:width], bus[width:]
    rows = Rows(wiring.names, wiring.types, grid)
    parts = SCHEMES[scheme].parts(wiring.lanes, bus, grid)
    advance, in_turn = SCHEMES[scheme].advance, SCHEMES[scheme].in_turn
    between_rows = in_turn and grid.stride > 1
    before = recorded.copy()
    with deferred_interrupt() as check_interrupt, rows.kept_on_failure(), ExitStack() as release:
        for lane in wiring.lanes:
            release.callback(_close, lane.component)
            stop_time = grid.time(grid.steps)
            lane.component.setup(grid.start_time, stop_time, lane.start_values, lane.inputs, tolerance)
        play(0, from_file)
        exchange(parts, bus, wiring)
        for part in parts:
            part.component.initialize()
        for part in parts:
            part.send()
        rows.take(recorded)
        ending: Ending | None = None
        done, stop = 0, grid.steps
        for k in _counted(stop, progress):
            if k == grid.steps:  # where a component has ended the simulation
                break
            check_interrupt()
            if from_file.size:
                play(k, from_file)
            if between_rows:
                np.copyto(before, recorded)
            found = advance(parts, grid, k)
            if found is not None:
                ending = earliest(ending, found)
                grid = grid.until(ending.steps)
                if ending.steps <= k:
                    if in_turn:
                        np.copyto(recorded, before if between_rows else rows.last)
                    break
            done = k + 1
            if done % grid.stride == 0:
                rows.take(recorded)
        check_interrupt()
        if ending is not None and ending.steps < stop:
            rows.end(ending, recorded, done)
    return rows.recording()


def _close(component: Component) -> None:
    with held():
        component.close()


def _counted(steps: int, progress: bool | None) -> Iterable[int]:
    shown = sys.stderr.isatty() if progress is None else progress
    if not shown:
        return range(steps)  # even a disabled tqdm starts a thread, which a later fork would warn about
    bar: Iterable[int] = tqdm(range(steps), delay=QUIET_SECONDS, unit="step", leave=False)
    return bar
