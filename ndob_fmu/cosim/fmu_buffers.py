"""Memory shared by NumPy and an FMU, laid out once so that a step allocates nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from fmpy import fmi2
from numpy.typing import NDArray

from ndob_fmu.cosim.component import Array

# FMI has one pair of functions for each C type; an Enumeration is an Integer to them.
_KINDS: tuple[tuple[str, tuple[str, ...], Any], ...] = (
    ("Real", ("Real",), fmi2.fmi2Real),
    ("Integer", ("Integer", "Enumeration"), fmi2.fmi2Integer),
    ("Boolean", ("Boolean",), fmi2.fmi2Boolean),
)


@dataclass(frozen=True, eq=False)
class Buffer:
    """The variables of one FMI type out of a longer list.

    positions: their places in that list, (len(names),). memory: what the FMU reads and writes; view: the same memory
    as an array, (len(names),).
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

    def scatter(self, values: Array) -> None:
        """Fill the memory from the longer list's values."""
        self.view[:] = values[self.positions]

    def gather(self, values: Array) -> None:
        """Write the memory into the longer list's values; Booleans become 0 or 1."""
        values[self.positions] = self.view != 0 if self.kind == "Boolean" else self.view

    def set(self, fmu: Any) -> None:
        """Hand the memory to the FMU in one call."""
        getattr(fmu, f"fmi2Set{self.kind}")(fmu.component, self.references, len(self.names), self.memory)

    def get(self, fmu: Any) -> None:
        """Have the FMU fill the memory in one call."""
        getattr(fmu, f"fmi2Get{self.kind}")(fmu.component, self.references, len(self.names), self.memory)


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
