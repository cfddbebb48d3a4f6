"""The interface of a component to the master. An FMU implements it, and so may a class in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.units import BaseUnit

Value: TypeAlias = float | int | bool | str


@dataclass(frozen=True)
class Variable:
    """One scalar variable of a component, in FMI's terms.

    causality: ``input``, ``output``, ``parameter``, ``calculatedParameter``, ``local`` or ``independent``.
    type: ``Real``, ``Integer``, ``Enumeration``, ``Boolean`` or ``String``.
    unit: None where none is declared.
    start: the value that the component itself starts with; None where none is declared.
    settable: whether the variable takes a start value.
    variability: signals are extrapolated between ``continuous`` Reals only.
    dependencies: the inputs on which an output depends directly, at the same communication point; None where the
        component declares nothing, so that the output may depend on every input.
    initial_dependencies: the same during initialization.
    base_unit: the meaning of the unit; None where it is not declared.
    items: (name, value) of each item of an Enumeration.
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

    time: the end of its last successful step, s. Its outputs are those at that time.
    reason: the component's message; empty if there was none.
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
        """All variables, known before ``setup`` and without running the component's code."""
        ...

    def setup(
        self,
        start_time: float,
        stop_time: float,
        start_values: Mapping[str, Value],
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
    """Return the outputs that are exchanged and recorded as numbers: all but Strings, in the component's own order."""
    return tuple(v for v in variables if v.causality == "output" and v.type != "String")
