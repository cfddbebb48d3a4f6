"""What the master needs of a component, whether an FMU or a few lines of Python in a test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.units import BaseUnit

Value: TypeAlias = float | int | bool | str


@dataclass(frozen=True)
class Variable:
    """One scalar of a component, in FMI's words.

    causality: ``input``, ``output``, ``parameter``, ``calculatedParameter``, ``local`` or ``independent``.
    type: ``Real``, ``Integer``, ``Enumeration``, ``Boolean`` or ``String``. unit: None where none is declared;
    base_unit: what it means, None where that is not declared. items: (name, value) of an Enumeration's.
    start: the value the component itself starts with, None if it declares none. settable: takes a start value.
    variability: only between ``continuous`` Reals is there anything to extrapolate. dependencies: of an output, the
    inputs that show in it at once when they change at a communication point; initial_dependencies: the same during
    initialization; None where nothing is declared, which may be every input.
    """

    name: str
    causality: str
    type: str = "Real"
    unit: str | None = None
    start: Value | None = None
    settable: bool = True
    variability: str = "continuous"
    dependencies: tuple[str, ...] | None = None
    initial_dependencies: tuple[str, ...] | None = None
    base_unit: BaseUnit | None = None
    items: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class Ended:
    """A component has ended the simulation.

    time: of its last successful step, s; its outputs are those at that time.
    reason: what it said, empty if it said nothing.
    """

    time: float
    reason: str = ""


class Component(Protocol):
    """One part of a coupled system. The order of the calls is always

    ``setup`` → any number of ``set_inputs`` and ``get_outputs`` → ``initialize`` → ``get_outputs`` →
    again and again ``set_inputs``, ``step``, ``get_outputs`` → ``close``.

    ``close`` comes exactly once after every ``setup``, also after one that failed halfway, and frees what is held;
    after it ``setup`` may come again. Any call may raise SimulationError.
    """

    @property
    def variables(self) -> Sequence[Variable]:
        """Every variable, known before ``setup`` and without running anything of the component."""
        ...

    def setup(
        self,
        start_time: float,
        stop_time: float,
        start_values: Mapping[str, Any],
        inputs: Sequence[str],
        tolerance: float | None = None,
    ) -> None:
        """Take the start values and begin initialization at ``start_time`` (s).

        inputs: the names whose values ``set_inputs`` will bring, in that order; other inputs keep their start value.
        tolerance: relative, for what the component solves inside a step; None is the component's own default.
        """
        ...

    def set_inputs(self, values: Array) -> None:
        """Take the inputs announced to ``setup``; values: (len(inputs),), valid only during the call."""
        ...

    def get_outputs(self, values: Array) -> None:
        """Write the numeric outputs into ``values``, in the order of ``recordable(variables)``."""
        ...

    def initialize(self) -> None:
        """End initialization."""
        ...

    def step(self, time: float, step_size: float) -> Ended | None:
        """Advance from ``time`` to ``time + step_size`` (s) with the inputs held.

        Return None, or that the component has ended the simulation within this step; it is not stepped again then.
        """
        ...

    def close(self) -> None:
        """Free everything that ``setup`` took."""
        ...


def recordable(variables: Sequence[Variable]) -> tuple[Variable, ...]:
    """Return the outputs that travel and are recorded as numbers: all but Strings, in the component's own order."""
    return tuple(v for v in variables if v.causality == "output" and v.type != "String")
