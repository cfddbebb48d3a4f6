"""FMI's functions for states, as pythonfmu calls them: an instance's memory saved, restored, written and read."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from fmus.slave_clock import Clock
from fmus.slave_messages import failure
from fmus.slave_state import Received, Snapshot, from_bytes, to_bytes
from fmus.slave_state_faults import same_form, state_fault
from fmus.slave_variables import Variables
from ndob_fmu.runtime.base_errors import NdobError


class RememberingSlave(Fmi2Slave):  # type: ignore[misc] # pythonfmu carries no type information
    """All that an instance remembers, and the functions that save and restore it.

    variables: with their present values
    clock: the times
    state: what the core of a slave remembers; None before it is made
    state_types: the classes that the state is made of, besides numbers, arrays and tuples
    started_with: the parameters that the core was made from; None before it is made
    initializing: whether the instance is in initialization mode
    stale: whether the outputs have to be computed before they are read
    """

    state_types: ClassVar[tuple[type, ...]] = ()
    variables: Variables
    clock: Clock
    state: Any = None
    started_with: tuple[Any, ...] | None = None
    initializing = False
    stale = False

    @abstractmethod
    def start(self, start_time: float) -> None:
        """Make the core anew from the parameters, and `state`. Raises NdobError if they allow no core."""

    @abstractmethod
    def say(self, fault: NdobError, status: Fmi2Status = Fmi2Status.error) -> None:
        """Log a fault."""

    def possible(self, state: Any, begin: float, now: float) -> bool:
        """Whether a run from `begin` to `now` (s) could lead to a state that has the form of the present one."""
        return True

    # -- called by pythonfmu

    def _get_fmu_state(self) -> Snapshot:
        made = self.started_with is not None
        return Snapshot(
            slave=self._identity(),
            values=tuple(self.variables.present),
            started_with=self.started_with,
            core=self.state if made else None,
            initializing=self.initializing,
            stale=self.stale,
            start_time=self.clock.start,
            stop_time=self.clock.stop,
            time=self.clock.now,
            step_size=self.clock.step_size,
        )

    def _set_fmu_state(self, state: Snapshot | Received | NdobError) -> None:
        fault = state if isinstance(state, NdobError) else self._restore(state)
        if fault:
            self.say(fault)

    @classmethod
    def _fmu_state_to_bytes(cls, state: Snapshot | Received | NdobError) -> bytes:
        """Return the bytes; those of a state that was refused when it was read are empty, and are refused again."""
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

    def _identity(self) -> str:
        return f"{type(self).__module__}.{type(self).__name__}"

    def _restore(self, state: Snapshot | Received) -> NdobError | None:
        """Take over a state, or leave everything as it is and return what is wrong with the state."""
        received = isinstance(state, Received)
        snapshot = state.snapshot if isinstance(state, Received) else state
        if snapshot.slave != self._identity():
            expected, given = (f"one of {name}" for name in (self._identity(), snapshot.slave))
            return NdobError.report("FMU state", expected=expected, received=given)
        fault = self._contents_fault(snapshot) if received else None
        fault = fault or self._make_core(snapshot, check=received)
        if fault:
            return fault
        self.variables.restore(snapshot.values)
        self.clock = Clock(snapshot.start_time, snapshot.stop_time, snapshot.time, snapshot.step_size)
        self.initializing, self.stale = snapshot.initializing, snapshot.stale
        self.started_with, self.state = snapshot.started_with, snapshot.core
        return None

    def _contents_fault(self, snapshot: Snapshot) -> NdobError | None:
        """Return what is wrong with the values and times of a state that came as bytes."""
        fault = state_fault(snapshot, self.variables.declared)
        if fault:
            return fault
        parameters = tuple(snapshot.values[reference] for reference in self.variables.parameters)
        if snapshot.initializing or snapshot.started_with in (None, parameters):
            return None
        return NdobError.report("FMU state", expected="the parameters that it started with", received="others")

    def _make_core(self, snapshot: Snapshot, *, check: bool) -> NdobError | None:
        """Make the core of the snapshot's parameters, or leave the present one and return why that cannot be.

        check: whether that core could have the snapshot's state.
        """
        started_with, before = snapshot.started_with, (self.variables.present, self.state)
        if started_with is None:
            return None
        try:
            if started_with != self.started_with:
                self._start_with(started_with, snapshot.start_time)
            if check and not self._can_have(snapshot):
                raise NdobError.report("FMU state", expected="what this FMU remembers", received="something else")
        except Exception as error:
            if self.started_with not in (None, started_with):
                self._start_with(self.started_with, self.clock.start)
            self.variables.present, self.state = before
            return failure("FMU state", error)
        return None

    def _can_have(self, snapshot: Snapshot) -> bool:
        """Whether the core, now in some state of the same parameters, could have the snapshot's state."""
        if not same_form(self.state, snapshot.core):
            return False
        with np.errstate(all="ignore"):
            return self.possible(snapshot.core, snapshot.start_time, snapshot.time)

    def _start_with(self, parameters: tuple[Any, ...], start_time: float) -> None:
        # In initialization mode other parameters may be set by now, and no core may exist for them.
        self.variables.set_parameters(parameters)
        with np.errstate(all="ignore"):
            self.start(start_time)
