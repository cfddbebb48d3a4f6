"""The coupling schemes: the order in which components step, and the values of their inputs during a step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ndob_fmu.cosim.component import Ended
from ndob_fmu.cosim.system.wiring import Lane
from ndob_fmu.cosim.time_grid import TimeGrid
from ndob_fmu.runtime.arrays import Array


class Part:
    """A component with the memory for its values. Its inputs hold the values that the bus has before the step."""

    def __init__(self, lane: Lane, bus: Array, grid: TimeGrid) -> None:
        self.component = lane.component
        self.name = lane.name
        self.place = lane.outputs
        self.ratio = lane.ratio
        self.step_size = lane.ratio * grid.step_size
        self.outputs = bus[lane.outputs]
        self._bus = bus
        self._lane = lane
        self._inputs = np.empty(len(lane.inputs))
        self._has_inputs, self._has_outputs = bool(lane.inputs), bool(self.outputs.size)
        # Sources that lie on the bus as the inputs do, one after another, are read where they are.
        first = int(lane.sources[0]) if lane.inputs else 0
        in_order = np.array_equal(lane.sources, np.arange(first, first + len(lane.inputs)))
        self._on_bus = bus[first : first + len(lane.inputs)] if in_order and not lane.scaled else None

    def receive(self, k: int) -> None:
        """Give the component the inputs for a step that begins while the master is at t_k."""
        if not self._has_inputs:
            return
        if self._on_bus is not None:
            self.component.set_inputs(self._on_bus)
            return
        np.take(self._bus, self._lane.sources, out=self._inputs, mode="clip")  # any other mode copies first
        self._deliver()

    def send(self) -> None:
        """Put the component's outputs on the bus."""
        if self._has_outputs:
            self.component.get_outputs(self.outputs)

    def arrive(self) -> None:
        """Put the outputs on the bus that the component has at the end of a step."""
        self.send()

    def _deliver(self) -> None:
        if self._lane.scaled:
            self._inputs *= self._lane.factors
            self._inputs += self._lane.offsets
        self.component.set_inputs(self._inputs)


class ExtrapolatedPart(Part):
    """Its inputs hold the value that their sources, extrapolated linearly, have in the middle of the step.

    The slopes of the outputs, per communication step, are 0 before the second value. They are 0 too where a value is
    not finite, so that a lost sample affects one step and not two.
    """

    def __init__(self, lane: Lane, bus: Array, slopes: Array, grid: TimeGrid) -> None:
        super().__init__(lane, bus, grid)
        self._slopes = slopes
        self._own_slopes = slopes[lane.outputs]
        self._before = np.empty_like(self.outputs)
        self._lost = np.empty(self.outputs.shape, dtype=np.bool_)
        self._ahead = np.empty(len(lane.inputs))
        self._lead = np.empty(len(lane.inputs))

    def receive(self, k: int) -> None:
        """Give the component the inputs for a step that begins at t_k, as they will be in its middle."""
        if self._has_inputs:
            lane = self._lane
            np.take(self._bus, lane.sources, out=self._inputs, mode="clip")
            np.take(self._slopes, lane.sources, out=self._ahead, mode="clip")
            np.remainder(k, lane.source_ratios, out=self._lead)  # since when the source has had its last value
            self._lead += lane.leads
            self._ahead *= self._lead
            self._inputs += self._ahead
            self._deliver()

    def arrive(self) -> None:
        """Put the outputs at the end of a step on the bus, with their slopes."""
        if self._has_outputs:
            np.copyto(self._before, self.outputs)
            self.component.get_outputs(self.outputs)
            with np.errstate(invalid="ignore", over="ignore"):  # slopes of infinite values are set to 0 below
                np.subtract(self.outputs, self._before, out=self._own_slopes)
            if self.ratio != 1:
                self._own_slopes /= self.ratio
            np.isfinite(self._own_slopes, out=self._lost)
            np.logical_not(self._lost, out=self._lost)
            np.copyto(self._own_slopes, 0.0, where=self._lost)


class Ending(NamedTuple):
    """A part has ended the simulation; steps: the number of complete communication steps before that."""

    part: Part
    ended: Ended
    steps: int


def earliest(before: Ending | None, found: Ending) -> Ending:
    """Return which of two endings comes first, ``found`` where there is no other."""
    return found if before is None or found.ended.time < before.ended.time else before


def _parallel(parts: Sequence[Part], grid: TimeGrid, k: int) -> Ending | None:
    ending = None
    for part in parts:
        # A step that would end after the stop time shows in no row.
        if k % part.ratio == 0 and k + part.ratio <= grid.steps:
            part.receive(k)
            ended = part.component.step(grid.time(k), part.step_size)
            if ended is not None:
                ending = earliest(ending, Ending(part, ended, grid.reached(ended.time)))
                if ending.steps <= k:
                    return ending
    for part in parts:
        if (k + 1) % part.ratio == 0:
            part.arrive()
    return ending


def _sequential(parts: Sequence[Part], grid: TimeGrid, k: int) -> Ending | None:
    ending = None
    for part in parts:
        # A longer step is made when the master reaches its end, so that its inputs are those of the end.
        if (k + 1) % part.ratio == 0:
            part.receive(k)
            ended = part.component.step(grid.time(k + 1 - part.ratio), part.step_size)
            if ended is not None:
                ending = earliest(ending, Ending(part, ended, grid.reached(ended.time)))
                if ending.steps <= k:
                    return ending
            part.arrive()
    return ending


def _held(lanes: Sequence[Lane], bus: Array, grid: TimeGrid) -> list[Part]:
    return [Part(lane, bus, grid) for lane in lanes]


def _extrapolated(lanes: Sequence[Lane], bus: Array, grid: TimeGrid) -> list[Part]:
    slopes = np.zeros_like(bus)
    return [ExtrapolatedPart(lane, bus, slopes, grid) for lane in lanes]


class Scheme(NamedTuple):
    """How a communication step is made.

    parts: (lanes, bus, grid) → a part for each lane.
    advance: (parts, grid, k) steps the parts to t_{k+1}. It returns the ending if a part has ended the simulation; if
        that was before t_{k+1}, the bus is left as it is.
    in_turn: parts step one after another, so that the bus may have values of t_{k+1} when a part ends.
    """

    parts: Callable[[Sequence[Lane], Array, TimeGrid], list[Part]]
    advance: Callable[[Sequence[Part], TimeGrid, int], Ending | None]
    in_turn: bool = False


SCHEMES = {
    "jacobi": Scheme(_held, _parallel),
    "gauss-seidel": Scheme(_held, _sequential, in_turn=True),
    "extrapolation": Scheme(_extrapolated, _parallel),
}
