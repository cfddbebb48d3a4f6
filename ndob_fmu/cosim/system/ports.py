"""Ports, which are variables of components, connections between them, and links to names at the boundary."""

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

    convert_units: the source is converted to the target's unit first. A System does so, and puts the conversion into
    factor and offset.
    """

    source: Port
    target: Port
    factor: float = 1.0
    offset: float = 0.0
    convert_units: bool = True

    def __str__(self) -> str:
        return f"{self.source} → {self.target}"


class Link(NamedTuple):
    """A port behind a name at the system's boundary.

    The port of an input receives factor · value + offset; an output has factor · (value of the port) + offset.
    """

    port: Port
    factor: float = 1.0
    offset: float = 0.0
