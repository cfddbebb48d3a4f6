"""Memory that NumPy and an FMU share. It is laid out once, so that a step allocates nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from ctypes import c_size_t, c_void_p
from dataclasses import dataclass
from typing import Any

import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array

# FMI has one pair of functions for each C type; an Enumeration is an Integer to them.
_KINDS: tuple[tuple[str, tuple[str, ...], Any], ...] = (
    ("Real", ("Real",), fmi2.fmi2Real),
    ("Integer", ("Integer", "Enumeration"), fmi2.fmi2Integer),
    ("Boolean", ("Boolean",), fmi2.fmi2Boolean),
)


def fmi_call(fmu: Any, name: str, *arguments: Any) -> Callable[[], None]:
    """Return a call of an FMI function with fixed arguments, all of them objects of ctypes.

    fmpy's own methods look the function up and convert the arguments each time, which may take longer than the step.
    The call raises FMICallException, as fmpy's methods do.
    """
    function, component = fmu.dll[name], c_void_p(fmu.component)

    def call() -> None:
        status = function(component, *arguments)
        if status > fmi2.fmi2Warning:
            raise FMICallException(function=name, status=status)

    return call


@dataclass(frozen=True, eq=False)
class Buffer:
    """The variables of one FMI type out of a longer list.

    positions: their places in that list, (len(names),).
    references: their value references.
    memory: where the FMU reads and writes them.
    view: the same memory as an array, (len(names),).
    """

    kind: str
    names: tuple[str, ...]
    positions: NDArray[np.intp]
    references: Any
    memory: Any
    view: NDArray[Any]

    def load(self, values: Sequence[Any]) -> None:
        """Fill the memory with one value for each name."""
        self.view[:] = values

    def set(self, fmu: Any) -> None:
        """Hand the memory to the FMU in one call."""
        self._call("Set", fmu, self.memory)()

    def setter(self, fmu: Any, values: Array) -> Callable[[], None]:
        """Return a function that sets the variables to the longer list's current values, in one FMI call."""
        in_place = self._in_place(values)
        if in_place is not None:
            return self._call("Set", fmu, in_place)
        call, view, positions = self._call("Set", fmu, self.memory), self.view, self.positions

        def set_from_values() -> None:
            view[:] = values[positions]
            call()

        return set_from_values

    def getter(self, fmu: Any, values: Array) -> Callable[[], None]:
        """Return a function that gets the variables into the longer list's values in one call; Booleans as 0 or 1."""
        in_place = self._in_place(values)
        if in_place is not None:
            return self._call("Get", fmu, in_place)
        call, view, positions = self._call("Get", fmu, self.memory), self.view, self.positions
        first, last = int(positions[0]), int(positions[-1])
        target = values[first : last + 1] if last - first + 1 == len(positions) else None

        def get_into_values() -> None:
            call()
            if target is None:
                values[positions] = view != 0 if self.kind == "Boolean" else view
            elif self.kind == "Boolean":
                np.not_equal(view, 0, out=target)
            else:
                np.copyto(target, view)

        return get_into_values

    def _call(self, access: str, fmu: Any, memory: Any) -> Callable[[], None]:
        return fmi_call(fmu, f"fmi2{access}{self.kind}", self.references, c_size_t(len(self.names)), memory)

    def _in_place(self, values: Array) -> Any:
        """Return the part of the longer list's memory that the FMU can use directly; None where it cannot."""
        first = int(self.positions[0])
        side_by_side = np.array_equal(self.positions, np.arange(first, first + len(self.positions)))
        usable = values.dtype == np.float64 and values.flags.c_contiguous and values.flags.writeable
        if self.kind != "Real" or not side_by_side or not usable:
            return None
        return type(self.memory).from_buffer(values, first * values.itemsize)


def buffers(names: Sequence[str], types: Mapping[str, str], references: Mapping[str, int]) -> list[Buffer]:
    """Return one buffer for each FMI type among ``names``, none for Strings, which have no fixed size."""
    found = []
    for kind, members, c_type in _KINDS:
        positions = [index for index, name in enumerate(names) if types[name] in members]
        if positions:
            chosen = tuple(names[index] for index in positions)
            memory = (c_type * len(chosen))()
            found.append(
                Buffer(
                    kind,
                    chosen,
                    np.array(positions, dtype=np.intp),
                    (fmi2.fmi2ValueReference * len(chosen))(*(references[name] for name in chosen)),
                    memory,
                    np.ctypeslib.as_array(memory),
                )
            )
    return found
