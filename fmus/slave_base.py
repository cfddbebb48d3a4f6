"""The base of all slaves: the calls of FMI as pythonfmu hands them on, and how they lead to the core of a subclass.

pythonfmu destroys an instance whose code raises. Nothing that a host or a user can do by mistake may raise here: it is
logged with a status, which the FMU's front (`ndob_fmu/fmu/compile_front.py`) makes the status of the call.
"""

from __future__ import annotations

import sys
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from pythonfmu.enums import Fmi2Status

from fmus.slave_clock import Clock
from fmus.slave_memory import RememberingSlave
from fmus.slave_messages import failure, printable
from fmus.slave_start_values import with_start_values
from fmus.slave_variables import NOTHING, Variables, slice_of
from ndob_fmu.interface.variables import Variable
from ndob_fmu.runtime.base_errors import NdobError


class Slave(RememberingSlave):
    """Base of the slaves; a subclass makes its core from the parameters and advances it.

    Outputs are computed in initialization mode as soon as they are asked for, and afterwards once per step. A subclass
    keeps all that its core remembers in `state`, an immutable value; the rest it makes anew from the parameters.
    """

    def __init__(self, variables: Sequence[Variable], **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.variables = Variables(with_start_values(variables, self.resources))
        self.clock = Clock()
        # The references that were read and set last, and their slice; None where they do not follow one another.
        self._last_read: tuple[list[int], slice | None] = ([], None)
        self._last_set: tuple[list[int], slice | None] = ([], None)

    # -- for the subclass, besides `start` and `possible`

    @abstractmethod
    def show(self) -> Sequence[Any]:
        """Return the outputs at the start, for the inputs set so far, in the order of their declaration."""

    @abstractmethod
    def advance(self, t: float, step_size: float) -> Sequence[Any]:
        """Take one step and return the outputs at its end, in the order of their declaration."""

    def advance_quickly(self, t: float, step_size: float) -> Sequence[Any] | None:
        """Take the same step without NumPy, or return None and change nothing where that cannot be done."""
        return None

    def values(self, names: Iterable[str]) -> list[Any]:
        """Return the present values of the named variables."""
        return self.variables.values(names)

    def value(self, name: str) -> Any:
        """Return the present value of one variable."""
        return self.variables.value(name)

    # -- called by pythonfmu: from mode to mode

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """Note when the simulation starts and stops; impossible times are refused."""
        fault = self.clock.set_up(start_time, stop_time)
        if fault:
            self.say(fault)

    def enter_initialization_mode(self) -> None:
        """From here on the outputs follow parameters and inputs at once."""
        self.initializing = self.stale = True
        self.started_with = None

    def exit_initialization_mode(self) -> None:
        """Fix the parameters. If they allow no core, the instance stays in initialization mode, for new ones."""
        if self._refresh():
            self.initializing = False

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance the core; a step that cannot be taken is logged and changes nothing.

        A step no longer than the rounding errors of a host that adds its steps up only advances the time.
        """
        clock = self.clock
        end = current_time + step_size
        continues = clock.continues(current_time, step_size)
        if not continues:
            fault = clock.step_fault(current_time, step_size)
            if fault:
                self.say(fault, Fmi2Status.discard)
                return False
        if clock.stop is not None:
            fault = clock.stop_fault(end, step_size)
            if fault:
                self.say(fault)
                return False
        # Without a front a host does not learn that initialization failed.
        if self.initializing or self.started_with is None:
            if not self._refresh(Fmi2Status.discard):
                return False
            self.initializing = False
        if not continues:
            rounding = clock.added_rounding(end)
            if step_size <= rounding:
                clock.now = max(clock.now, end)
                return True
            fault = clock.end_fault(end)
            if fault:
                self.say(fault, Fmi2Status.discard)
                return False
            step_size = clock.settled(step_size, end, rounding)
        before = self.state
        try:
            outputs = self.advance_quickly(current_time, step_size)
            if outputs is None:
                with np.errstate(all="ignore"):  # as in _refresh
                    outputs = self.advance(current_time, step_size)
            variables = self.variables
            variables.present[variables.outputs] = outputs
        except Exception as error:
            self.state = before
            self.say(failure("step", error), Fmi2Status.discard)
            return False
        clock.now, clock.step_size = end, step_size
        return True

    # -- called by pythonfmu: values

    def get_real(self, vrs: list[int]) -> list[float]:
        """Return the values of Real variables."""
        # A host reads the same outputs after each step, and mostly all of them, which are declared one after another.
        known, at = self._last_read
        if vrs != known or self.stale or at is None:
            return self._get("Real", vrs)
        return self.variables.present[at]

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Return the values of Boolean variables."""
        return self._get("Boolean", vrs)

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Return the values of Integer and Enumeration variables."""
        return self._get("Integer", vrs)

    def get_string(self, vrs: list[int]) -> list[str]:
        """Return the values of String variables."""
        return self._get("String", vrs)

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set Real variables."""
        known, at = self._last_set
        if vrs != known or self.initializing or at is None:
            self._set("Real", vrs, values)
        else:
            self.variables.present[at] = values

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Set Boolean variables."""
        self._set("Boolean", vrs, values)

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set Integer and Enumeration variables."""
        self._set("Integer", vrs, values)

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Set String variables."""
        self._set("String", vrs, values)

    # -- messages

    def log(self, msg: str, status: Fmi2Status) -> None:
        """Send a message to the host, in the log category of its status."""
        # pythonfmu's binary passes the text on as a printf format and crashes on text that is not UTF-8. It never frees
        # the texts; interning makes equal ones one.
        super().log(sys.intern(printable(msg)), status, sys.intern(f"logStatus{status.name.capitalize()}"))

    def say(self, fault: NdobError, status: Fmi2Status = Fmi2Status.error) -> None:
        """Log a fault."""
        self.log(str(fault), status)

    # -- inside

    def _mode(self) -> str:
        """Return FMI's name of the present mode. pythonfmu does not tell a slave when a simulation is terminated."""
        if self.initializing:
            return "initialization"
        return "instantiated" if self.started_with is None else "stepping"

    def _get(self, kind: str, vrs: list[int]) -> list[Any]:
        if kind != "Real" or vrs != self._last_read[0]:
            fault = self.variables.reference_fault(kind, vrs)
            if fault:
                self.say(fault)
                return [NOTHING[kind]] * len(vrs)
            if kind == "Real":
                self._last_read = vrs, slice_of(vrs)
        if self.stale:
            self._refresh()
        present = self.variables.present
        return [present[reference] for reference in vrs]

    def _set(self, kind: str, vrs: list[int], values: list[Any]) -> None:
        variables = self.variables
        fault = variables.reference_fault(kind, vrs)
        if fault:
            self.say(fault)
            return
        mode = self._mode()
        for reference, value in zip(vrs, values, strict=True):
            if reference in variables.inputs:
                variables.present[reference] = value
            elif fault := variables.set_parameter(reference, value, mode):
                self.say(fault)
        self.stale = self.initializing
        if kind == "Real" and variables.inputs.issuperset(vrs):
            self._last_set = vrs, slice_of(vrs)

    def _refresh(self, status: Fmi2Status = Fmi2Status.error) -> bool:
        """Bring the outputs up to date in initialization mode; log with this status if that cannot be done."""
        variables = self.variables
        parameters = variables.parameter_values()
        try:
            if variables.refused:
                self.log(next(iter(variables.refused.values())), status)
                return False
            # Overflow shows in the result; a host that turns NumPy's warnings into errors must not see one.
            with np.errstate(all="ignore"):
                if parameters != self.started_with:
                    self.started_with = None
                    self.start(self.clock.start)
                    self.started_with = parameters
                shown = self.show()
            if len(shown) != len(variables.present[variables.outputs]):
                raise ValueError(f"{len(shown)} values for another number of outputs")
            variables.present[variables.outputs] = shown
        except Exception as error:
            self.say(failure("start", error), status)
            return False
        self.stale = False
        return True
