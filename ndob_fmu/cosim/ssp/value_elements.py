"""How a variable's type, value, unit and scaling stand in the files of a package."""

from __future__ import annotations

from ndob_fmu.cosim.component import Value, Variable
from ndob_fmu.cosim.ssp.markup import add
from ndob_fmu.cosim.ssp.schema import Element
from ndob_fmu.cosim.system.ports import AS_IT_IS
from ndob_fmu.errors import ModelError
from ndob_fmu.support.units import BaseUnit, base_unit


class UsedUnits:
    """The units that the elements of one file name, which the file has to define."""

    def __init__(self) -> None:
        self._meanings: dict[str, BaseUnit] = {}

    def name_unit(self, element: Element, variable: Variable) -> None:
        """Give an element the unit of a Real variable; one without a known meaning is left out: no tool converts it."""
        meaning = _meaning(variable) if variable.type == "Real" else None
        if variable.unit and meaning is not None:
            self._meanings[variable.unit] = meaning
            element.set("unit", variable.unit)

    def define(self, parent: Element, name: str) -> None:
        """Add the definitions of the units under an element ``name``, if there are any."""
        group = add(parent, name) if self._meanings else None
        for unit, meaning in sorted(self._meanings.items()):
            add(add(group, "ssc:Unit", name=unit), "ssc:BaseUnit", **meaning.attributes())


def _meaning(variable: Variable) -> BaseUnit | None:
    if not variable.unit or variable.base_unit is not None:
        return variable.base_unit
    try:
        return base_unit(variable.unit)
    except ModelError:
        return None


def written_type(variable: Variable) -> str:
    """Return the type that goes into the file: libcosim gives up at an Enumeration there."""
    return "Integer" if variable.type == "Enumeration" else variable.type


def literal(variable: Variable, value: Value) -> str:
    """Return a value as XML has it."""
    if variable.type == "Boolean":
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def add_transformation(element: Element, factor: float, offset: float) -> None:
    """Add factor and offset, if they change anything; the conversion of units is in them, which some tools omit."""
    if (factor, offset) != AS_IT_IS:
        element.set("suppressUnitConversion", "true")
        add(element, "ssc:LinearTransformation", factor=repr(factor), offset=repr(offset))
