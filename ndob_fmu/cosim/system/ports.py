"""Variables of components and what lies between them: a connection, a name at the system's boundary."""

from __future__ import annotations

from typing import NamedTuple

AS_IT_IS = (1.0, 0.0)  # the factor and offset of a value that is passed on unchanged


class Port(NamedTuple):
    """One variable of one component of the system."""

    component: str
    variable: str

    def __str__(self) -> str:
        return f"{self.component}.{self.variable}"


class Connection(NamedTuple):
    """The output ``source`` drives the input ``target``, which receives factor · source + offset.

    convert_units: with the source converted to the target's unit before; a System does so and puts it into factor and
    offset.
    """

    source: Port
    target: Port
    factor: float = 1.0
    offset: float = 0.0
    convert_units: bool = True

    def __str__(self) -> str:
        return f"{self.source} → {self.target}"


class Link(NamedTuple):
    """A port behind a name at the system's boundary, where it has factor · value + offset: set by an input, shown by an
    output.
    """

    port: Port
    factor: float = 1.0
    offset: float = 0.0
