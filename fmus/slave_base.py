"""What all slaves share: variables as declared, when their values are right, what is refused, and their memory.

pythonfmu answers an exception by destroying the instance. So nothing that a host or a user can do by mistake raises
here: it is logged with a status, which the FMU's front (`ndob_fmu/fmu/compile_front.py`) makes the status of the call.
"""

from __future__ import annotations

import sys
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from math import nan, ulp
from typing import Any, ClassVar

import numpy as np
from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from fmus.slave_guards import (
    PYTHON_TYPES,
    added_rounding,
    experiment_fault,
    failure,
    parameter_fault,
    printable,
    step_fault,
    stop_fault,
)
from fmus.slave_start_values import with_start_values
from fmus.slave_state import Received, Snapshot, from_bytes, to_bytes
from fmus.slave_state_faults import same_form, state_fault
from ndob_fmu.interface.fmi_rules import NOT_SETTABLE, SETTABLE, role
from ndob_fmu.interface.variables import Variable
from ndob_fmu.runtime.base_errors import NdobError

# FMI has no functions for Enumerations.
_ACCESSED_AS = {"Enumeration": "Integer"}
_NOTHING = {"Real": nan, "Boolean": False, "Integer": 0, "String": ""}


class Slave(Fmi2Slave):  # type: ignore[misc] # pythonfmu carries no type information
    """Base of the slaves; a subclass makes its core from the parameters and advances it.

    Outputs are computed in initialization mode as soon as they are asked for, and afterwards once per step. A subclass
    keeps all that its core remembers in `state`, an immutable value made of numbers, arrays, tuples and `state_types`;
    the rest it makes anew from the parameters.
    """

    state_types: ClassVar[tuple[type, ...]] = ()
    state: Any = None

    def __init__(self, variables: Sequence[Variable], **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._variables = variables = with_start_values(variables, self.resources)
        self._value_reference = {variable.name: index for index, variable in enumerate(variables)}
        self._values: list[Any] = [PYTHON_TYPES[v.type]() if v.start is None else v.start for v in variables]
        self._of_type = {
            kind: frozenset(i for i, v in enumerate(variables) if _ACCESSED_AS.get(v.type, v.type) == kind)
            for kind in _NOTHING
        }
        self._input_references = frozenset(self._references("input"))
        self._shown = self.stretch([variable.name for variable in variables if variable.causality == "output"])
        self._parameter_references = self._references("parameter")
        # The references that were asked for and set last, and the slice that they are; None where they are none.
        self._real_outputs: tuple[list[int], slice | None] = ([], None)
        self._real_inputs: tuple[list[int], slice | None] = ([], None)
        self._refused = self._refusals()
        self._started_with: tuple[Any, ...] | None = None
        self._initializing = False
        self._stale = False
        self._start_time = self._time = self._step_size = 0.0
        self._stop_time: float | None = None

    # -- for the subclass

    @abstractmethod
    def start(self, start_time: float) -> None:
        """Make the core anew from the parameters, and `state`. Raises NdobError where they admit none."""

    @abstractmethod
    def show(self) -> Sequence[Any]:
        """Return the outputs at the start, for the inputs set so far, in the order of their declaration."""

    @abstractmethod
    def advance(self, t: float, step_size: float) -> Sequence[Any]:
        """Take one step and return the outputs at its end, in the order of their declaration."""

    def advance_quickly(self, t: float, step_size: float) -> Sequence[Any] | None:
        """Do the same without NumPy, or return None and change nothing where that cannot be done."""
        return None

    def possible(self, state: Any, begin: float, now: float) -> bool:
        """Whether a run from `begin` to `now` (s) could lead to a state that has the form of the present one."""
        return True

    def stretch(self, names: Sequence[str]) -> slice:
        """Return where the values of variables lie that are declared one after another."""
        at = _stretch([self._value_reference[name] for name in names])
        if at is None:
            raise ValueError(f"variables that are not declared one after another: {', '.join(names)}")
        return at

    def values(self, names: Iterable[str]) -> list[Any]:
        """Return the present values of the named variables."""
        return [self._values[self._value_reference[name]] for name in names]

    def value(self, name: str) -> Any:
        """Return the present value of one variable."""
        return self._values[self._value_reference[name]]

    # -- called by pythonfmu: from mode to mode

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """Note when the simulation starts and stops; impossible times are refused."""
        fault = experiment_fault(start_time, stop_time)
        if fault:
            self._say(fault)
            return
        self._start_time = self._time = start_time
        self._stop_time, self._step_size = stop_time, 0.0

    def enter_initialization_mode(self) -> None:
        """From here on the outputs follow parameters and inputs at once."""
        self._initializing = self._stale = True
        self._started_with = None

    def exit_initialization_mode(self) -> None:
        """Fix the parameters; with some that admit no core the instance stays in initialization mode, for others."""
        if self._refresh():
            self._initializing = False

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance the core; a step that cannot be taken is logged and changes nothing.

        A step no longer than the rounding errors of a host that adds its steps up only advances the time.
        """
        end = current_time + step_size
        goes_on_as_it_did = step_size and step_size == self._step_size and end > current_time == self._time
        if not goes_on_as_it_did:
            fault = step_fault(current_time, step_size, self._time, self._step_size)
            if fault:
                self._say(fault, Fmi2Status.discard)
                return False
        if self._stop_time is not None:
            fault = stop_fault(end, step_size, self._stop_time)
            if fault:
                self._say(fault)
                return False
        # Without a front a host does not learn that initialization failed.
        if self._initializing or self._started_with is None:
            if not self._refresh(Fmi2Status.discard):
                return False
            self._initializing = False
        if not goes_on_as_it_did:
            rounding = added_rounding(end, self._start_time, self._step_size)
            if step_size <= rounding:
                self._time = end
                return True
            # A step that is the difference of two rounded times varies in its last bits; each would get a design.
            if self._step_size and abs(step_size - self._step_size) <= max(2.0 * ulp(end), rounding):
                step_size = self._step_size
        before = self.state
        try:
            outputs = self.advance_quickly(current_time, step_size)
            if outputs is None:
                with np.errstate(all="ignore"):  # as in _refresh
                    outputs = self.advance(current_time, step_size)
            self._values[self._shown] = outputs
        except Exception as error:
            self.state = before
            self._say(failure("step", error), Fmi2Status.discard)
            return False
        self._time, self._step_size = end, step_size
        return True

    # -- called by pythonfmu: values

    def get_real(self, vrs: list[int]) -> list[float]:
        """Return the values of Real variables."""
        # Hosts ask for the same ones again and again, most often for some that are declared one after another.
        known, at = self._real_outputs
        if vrs != known or self._stale or at is None:
            return self._get("Real", vrs)
        return self._values[at]

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
        known, at = self._real_inputs
        if vrs != known or self._initializing or at is None:
            self._set("Real", vrs, values)
        else:
            self._values[at] = values

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Set Boolean variables."""
        self._set("Boolean", vrs, values)

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set Integer and Enumeration variables."""
        self._set("Integer", vrs, values)

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Set String variables."""
        self._set("String", vrs, values)

    # -- called by pythonfmu: the memory

    def _get_fmu_state(self) -> Snapshot:
        made = self._started_with is not None
        return Snapshot(
            slave=self._identity(),
            values=tuple(self._values),
            started_with=self._started_with,
            core=self.state if made else None,
            initializing=self._initializing,
            stale=self._stale,
            start_time=self._start_time,
            stop_time=self._stop_time,
            time=self._time,
            step_size=self._step_size,
        )

    def _set_fmu_state(self, state: Snapshot | Received | NdobError) -> None:
        if isinstance(state, NdobError):
            self._say(state)
            return
        snapshot = state.snapshot if isinstance(state, Received) else state
        if snapshot.slave != self._identity():
            self._report("FMU state", f"one of {self._identity()}", f"one of {snapshot.slave}")
            return
        fault = self._received_fault(snapshot) if isinstance(state, Received) else self._restart(snapshot)
        if fault:
            self._say(fault)
            return
        self._values = list(snapshot.values)
        self._refused = self._refusals()
        self._initializing, self._stale = snapshot.initializing, snapshot.stale
        self._start_time, self._stop_time = snapshot.start_time, snapshot.stop_time
        self._time, self._step_size = snapshot.time, snapshot.step_size
        self._started_with, self.state = snapshot.started_with, snapshot.core

    @classmethod
    def _fmu_state_to_bytes(cls, state: Snapshot | Received | NdobError) -> bytes:
        """Return the bytes; what was refused when it was read has none, and is refused again."""
        if isinstance(state, NdobError):
            return b""
        return to_bytes(state.snapshot if isinstance(state, Received) else state)

    @classmethod
    def _fmu_state_from_bytes(cls, data: bytes) -> Received | NdobError:
        """Return what the bytes hold, or why they hold nothing: pythonfmu calls the class, which cannot log."""
        try:
            return from_bytes(data, cls.state_types)
        except NdobError as error:
            return error

    # -- inside

    def log(self, msg: str, status: Fmi2Status) -> None:
        """Say it to the host, by the category of its status."""
        # pythonfmu's binary passes the text on as a printf format, and does not survive one that has no UTF-8. It never
        # gives up the texts, so equal ones should be one.
        super().log(sys.intern(printable(msg)), status, sys.intern(f"logStatus{status.name.capitalize()}"))

    def _received_fault(self, snapshot: Snapshot) -> NdobError | None:
        """Make the core of a snapshot that came as bytes, or leave all as it is and return what is wrong with it."""
        fault = state_fault(snapshot, self._variables)
        if fault:
            return fault
        parameters = tuple(snapshot.values[vr] for vr in self._parameter_references)
        if not snapshot.initializing and snapshot.started_with not in (None, parameters):
            return NdobError.report("FMU state", expected="the parameters that it started with", received="others")
        return self._restart(snapshot, check=True)

    def _restart(self, snapshot: Snapshot, *, check: bool = False) -> NdobError | None:
        """Make the core of the snapshot's parameters, or leave the present one and return why that cannot be.

        check: whether that core could have the snapshot's state.
        """
        started_with, before = snapshot.started_with, (self._values, self.state)
        if started_with is None:
            return None
        try:
            if started_with != self._started_with:
                self._start_with(started_with, snapshot.start_time)
            if check and not self._holds(snapshot):
                raise NdobError.report("FMU state", expected="what this FMU remembers", received="something else")
        except Exception as error:
            if self._started_with not in (None, started_with):
                self._start_with(self._started_with, self._start_time)
            self._values, self.state = before
            return failure("FMU state", error)
        return None

    def _holds(self, snapshot: Snapshot) -> bool:
        """Whether the core, in its present state one of the same parameters, could have the snapshot's."""
        if not same_form(self.state, snapshot.core):
            return False
        with np.errstate(all="ignore"):
            return self.possible(snapshot.core, snapshot.start_time, snapshot.time)

    def _start_with(self, parameters: tuple[Any, ...], start_time: float) -> None:
        """Start with these, since in initialization mode others may have been set that need not even admit a core."""
        self._values = list(self._values)
        for vr, value in zip(self._parameter_references, parameters, strict=True):
            self._values[vr] = value
        with np.errstate(all="ignore"):
            self.start(start_time)

    def _refusals(self) -> dict[int, str]:
        """Return why parameters cannot be used as they are, by value reference."""
        return {
            vr: str(fault)
            for vr in self._parameter_references
            if (fault := parameter_fault(self._variables[vr], self._values[vr]))
        }

    def _references(self, causality: str) -> list[int]:
        return [index for index, variable in enumerate(self._variables) if variable.causality == causality]

    def _identity(self) -> str:
        return f"{type(self).__module__}.{type(self).__name__}"

    def _get(self, kind: str, vrs: list[int]) -> list[Any]:
        if kind != "Real" or vrs != self._real_outputs[0]:
            if not self._known(kind, vrs):
                return [_NOTHING[kind]] * len(vrs)
            if kind == "Real":
                self._real_outputs = vrs, _stretch(vrs)
        if self._stale:
            self._refresh()
        return [self._values[vr] for vr in vrs]

    def _set(self, kind: str, vrs: list[int], new: list[Any]) -> None:
        if not self._known(kind, vrs):
            return
        for vr, value in zip(vrs, new, strict=True):
            if vr in self._input_references or self._may_set(vr, value):
                self._values[vr] = value
        self._stale = self._initializing
        if kind == "Real" and self._input_references.issuperset(vrs):
            self._real_inputs = vrs, _stretch(vrs)

    def _known(self, kind: str, vrs: list[int]) -> bool:
        known = self._of_type[kind]
        if known.issuperset(vrs):
            return True
        unknown = next(vr for vr in vrs if vr not in known)
        self._report("value reference", f"one of a {kind} variable", str(unknown))
        return False

    def _may_set(self, vr: int, value: Any) -> bool:
        variable = self._variables[vr]
        if self._mode() not in SETTABLE[role(variable)]:
            self._report(variable.name, *NOT_SETTABLE[role(variable)])
            return False
        self._refused.pop(vr, None)
        fault = parameter_fault(variable, value)
        if fault:
            # It is kept, so that a host that overlooks the status does not run with another value than it set.
            self._refused[vr] = str(fault)
            self._say(fault)
        return True

    def _mode(self) -> str:
        """Return FMI's name of the present mode; the slave does not learn of the end."""
        if self._initializing:
            return "initialization"
        return "instantiated" if self._started_with is None else "stepping"

    def _report(self, where: str, expected: str, received: str) -> None:
        self._say(NdobError.report(where, expected=expected, received=received))

    def _say(self, fault: NdobError, status: Fmi2Status = Fmi2Status.error) -> None:
        self.log(str(fault), status)

    def _refresh(self, status: Fmi2Status = Fmi2Status.error) -> bool:
        """Bring the outputs up to date in initialization mode; log why, with this status, where that cannot be done."""
        parameters = tuple(self._values[vr] for vr in self._parameter_references)
        try:
            if self._refused:
                self.log(next(iter(self._refused.values())), status)
                return False
            # Overflow is found by its result; a host that makes errors of warnings must not see it as one.
            with np.errstate(all="ignore"):
                if parameters != self._started_with:
                    self._started_with = None
                    self.start(self._start_time)
                    self._started_with = parameters
                shown = self.show()
            if len(shown) != len(self._values[self._shown]):
                raise ValueError(f"{len(shown)} values for other outputs than that")
            self._values[self._shown] = shown
        except Exception as error:
            self._say(failure("start", error), status)
            return False
        self._stale = False
        return True


def _stretch(vrs: list[int]) -> slice | None:
    """Return the slice that a list of value references is; None where they do not follow one another."""
    at = slice(vrs[0], vrs[0] + len(vrs)) if vrs else slice(0)
    return at if vrs == list(range(at.start or 0, at.stop)) else None
