"""A variable of an FMU as the model description lists it and the slave holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any


@dataclass(frozen=True)
class Enumeration:
    """A type whose values have names.

    name: of the type in the model description
    items: the value of each item
    texts: what each item means
    """

    name: str
    items: Mapping[str, int]
    texts: Mapping[str, str]


@dataclass(frozen=True)
class Variable:
    """One FMI variable.

    name: without dots for inputs and outputs
    causality: input, output or parameter
    description: one line without a full stop
    type: Real, Integer, Boolean, String or Enumeration
    start: None for an output, which is calculated
    unit: as the model description names it; "" for none
    minimum, maximum, nominal: in the unit; None where not declared
    enumeration: of a variable of that type
    depends_on: the inputs that an output follows already in initialization mode; between two steps an output keeps its
        value from the end of the last step, however the inputs change
    sampled: a signal that is read at the start of a step, or made once for each step; a value extrapolated into the
        step would be wrong
    positive: the minimum, which is 0, is itself not allowed
    """

    name: str
    causality: str
    description: str
    type: str = "Real"
    start: float | int | bool | str | None = None
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    enumeration: Enumeration | None = None
    depends_on: tuple[str, ...] = ()
    sampled: bool = False
    positive: bool = False

    @property
    def items(self) -> Mapping[str, int] | None:
        """The values of an Enumeration by their names; None for other types."""
        return self.enumeration.items if self.enumeration else None

    @property
    def variability(self) -> str:
        """FMI variability: parameters are fixed, numbers that flow are continuous, samples and flags discrete."""
        if self.causality == "parameter":
            return "fixed"
        return "continuous" if self.type == "Real" and not self.sampled else "discrete"


def expected_value(variable: Variable) -> str:
    """Return what a message says is expected of a parameter's value; "" where every value is good."""
    if variable.type in ("Boolean", "String"):
        return ""
    if variable.items is not None:
        return "one of " + ", ".join(f"{number} ({item})" for item, number in variable.items.items())
    least = "" if variable.minimum is None else " > 0" if variable.positive else f" of at least {variable.minimum:g}"
    most = "" if variable.maximum is None else f" and at most {variable.maximum:g}"
    return f"a finite number{least}{most}"


def is_acceptable(variable: Variable, value: Any) -> bool:
    """Return whether a value of the parameter's type is one that it may have."""
    if variable.type in ("Boolean", "String"):
        return True
    if variable.items is not None:
        return value in variable.items.values()
    too_small = (variable.minimum is not None and value < variable.minimum) or (variable.positive and value <= 0.0)
    too_large = variable.maximum is not None and value > variable.maximum
    return isfinite(value) and not too_small and not too_large


def parameter(
    name: str,
    start: float | int | bool | str,
    description: str,
    *,
    type: str = "Real",  # noqa: A002 # as FMI and `Variable` call it
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    positive: bool = False,
    enumeration: Enumeration | None = None,
) -> Variable:
    """Return a parameter. A Real far from 1 gets the size of its start value as its nominal value."""
    far_from_one = type == "Real" and not 1e-3 < (abs(float(start)) or 1.0) < 1e3
    return Variable(
        name=name,
        causality="parameter",
        description=description,
        type="Enumeration" if enumeration else type,
        start=start,
        unit=unit,
        positive=positive,
        minimum=0.0 if positive else minimum,
        maximum=maximum,
        nominal=abs(float(start)) if far_from_one else None,
        enumeration=enumeration,
    )
