"""The units that the files of a package define, and the linear transformations of their connections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from ndob_fmu.cosim.ssp.schema import Element, child, local_name
from ndob_fmu.support.units import BASE_UNITS, BaseUnit, Unit

Units: TypeAlias = Mapping[str, BaseUnit]


def read_units(root: Element) -> Units:
    """Return the units that a file defines, by name."""
    found = {}
    for group in root.iterchildren("*"):
        for entry in group.iterchildren("*") if local_name(group) == "Units" else ():
            base: Any = child(entry, "ssc:BaseUnit")  # the schema demands it
            powers = tuple(int(base.get(name, 0)) for name in BASE_UNITS)
            found[entry.get("name")] = BaseUnit(powers, float(base.get("factor", 1)), float(base.get("offset", 0)))
    return found


def unit_of(entry: Element, units: Units) -> Unit:
    """Return the unit that an element names, with its meaning where the file defines it."""
    name = entry.get("unit")
    return Unit(name, units.get(name))


def linear(element: Element) -> tuple[float, float]:
    """Return (factor, offset) of the transformation in a connection or mapping entry: 1 and 0 where there is none."""
    transformation = child(element, "ssc:LinearTransformation")
    if transformation is None:
        return 1.0, 0.0
    return float(transformation.get("factor", 1)), float(transformation.get("offset", 0))


def suppressed(element: Element) -> bool:
    """Whether a connection or mapping entry takes the value in the unit that it has."""
    return element.get("suppressUnitConversion") in ("true", "1")
