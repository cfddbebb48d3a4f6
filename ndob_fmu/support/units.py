"""Units as FMI and SSP define them: powers of the base units of the SI and of the radian, a factor and an offset."""

from __future__ import annotations

import functools
import re
import tokenize
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from ndob_fmu.errors import ModelError

if TYPE_CHECKING:
    import pint

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_NAMES = {
    "kilogram": "kg",
    "meter": "m",
    "second": "s",
    "ampere": "A",
    "kelvin": "K",
    "mole": "mol",
    "candela": "cd",
    "radian": "rad",
}


# What counts has no dimension: increments of an encoder.
_COUNTS = ("count", "bit")
# Symbols as engineers write them. Without these Nm is the number meter of yarns, Nms several of them, PS a petasiemens,
# and pu a part of the mass of an atom.
_DEFINITIONS = (
    "@alias ohm = Ohm",
    "newton_meter = newton * meter = Nm",
    "newton_meter_second = newton * meter * second = Nms",
    "per_unit = 1 = pu",
    "@alias metric_horsepower = PS",
    "@alias turn = rev",
    "@alias count = inc = counts",
)
_PRODUCTS = ("Nm", "Nms")
# Letters of a symbol, at most.
_SYMBOL = 3


@dataclass(frozen=True)
class BaseUnit:
    """What a unit means: a value v of it is factor · v + offset in the base units.

    powers: (8,), the exponents of ``BASE_UNITS``.
    """

    powers: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0

    def __str__(self) -> str:
        """Return the meaning in Modelica's notation: ``100000 kg.m-1.s-2``, ``1 K + 273.15``."""
        powers = [
            base + (str(power) if power != 1 else "")
            for base, power in zip(BASE_UNITS, self.powers, strict=True)
            if power
        ]
        offset = f" {'+' if self.offset > 0 else '-'} {abs(self.offset):.12g}" if self.offset else ""
        return " ".join([f"{self.factor:.12g}", ".".join(powers)]).rstrip() + offset

    def attributes(self) -> dict[str, str]:
        """Return the attributes of the element BaseUnit in FMI and SSP, without those that have their default."""
        found = {base: str(power) for base, power in zip(BASE_UNITS, self.powers, strict=True) if power}
        if self.factor != 1.0:
            found["factor"] = repr(self.factor)
        if self.offset != 0.0:
            found["offset"] = repr(self.offset)
        return found


def base_unit(name: str, where: str = "") -> BaseUnit | None:
    """Return what a unit in Modelica's notation means; None for a broken power like cm2.5, for which FMI has no form.

    where: whose unit it is, for the message

    Raises ModelError for a text that is not a unit.
    """
    # As in Modelica a dot multiplies and a power follows its unit at once: kg.m2/s2.
    formula = re.sub(r"(?<=[A-Za-z])\^?(-?\d+(?:\.\d+)?)", r"**(\1)", name)
    formula = re.sub(r"\.(?!\d)", "*", formula)
    try:
        one, zero = (_registry().Quantity(value, formula).to_base_units() for value in (1.0, 0.0))
        powers = {_NAMES[base]: complex(power).real for base, power in one.unit_items() if base not in _COUNTS}
    except _not_a_unit() as error:
        _registry().Quantity(1.0, "kg").to_base_units()  # raises where the fault is the library's, not the text's
        raise ModelError.report(
            where or f"unit {name!r}",
            expected="a unit of physics, like N.m, rad/s or kg.m2",
            received=f"{name!r} ({' '.join(str(error).split())})",
            likely=likely_unit(name),
        ) from error
    if not all(power.is_integer() for power in powers.values()):
        return None
    factor, offset = float(one.magnitude - zero.magnitude), float(zero.magnitude)
    return BaseUnit(tuple(int(powers.get(base, 0)) for base in BASE_UNITS), factor, offset)


def likely_unit(text: str) -> str:
    """Return the likely cause of a text that is no unit: Volt in place of V, Vs in place of V.s; empty for others."""
    meant = re.sub(r"[A-Za-z]+", lambda word: _as_units(word[0]), text)
    return "" if meant == text else f"did you mean {meant!r}?"


def _as_units(word: str) -> str:
    """Return a word in the symbols of units, as it is where there are none."""
    if _is_unit(word):
        return word
    if _is_unit(word.lower()):
        symbol = f"{_registry().parse_units(word.lower()):~}"
        return symbol if symbol.isascii() and symbol.isalpha() else word.lower()
    halves = ((word[:k], word[k:]) for k in range(len(word) - 1, 0, -1))
    two = next((pair for pair in halves if all(map(_is_symbol, pair))), (word,))
    return ".".join(two)


def _is_symbol(word: str) -> bool:
    """Return whether a word is the symbol of a unit that is not a product itself: Nmm is N.mm, not Nm.m."""
    return len(word) <= _SYMBOL and word not in _PRODUCTS and _is_unit(word)


def _is_unit(word: str) -> bool:
    try:
        _registry().parse_units(word)
    except _not_a_unit():
        return False
    return True


def _not_a_unit() -> tuple[type[Exception], ...]:
    import pint

    # pint raises these for a text that is not a unit. Other errors, like a plain AttributeError, are a library's fault.
    return (pint.PintError, tokenize.TokenError, ArithmeticError, AssertionError, KeyError, TypeError, ValueError)


@functools.cache
def _registry() -> pint.UnitRegistry[float]:
    import pint  # slow to load: only for units that nobody defines

    registry: pint.UnitRegistry[float] = pint.UnitRegistry(on_redefinition="ignore")  # a third of a second each
    for definition in _DEFINITIONS:
        registry.define(definition)
    return registry


def conversion(source: BaseUnit, target: BaseUnit) -> tuple[float, float] | None:
    """Return (factor, offset) that turn a value of ``source`` into one of ``target``; None if none can."""
    if source.powers != target.powers:
        return None
    return source.factor / target.factor, (source.offset - target.offset) / target.factor


class Unit(NamedTuple):
    """A unit by its name and, where somebody has defined it, its meaning; both None for a signal without unit."""

    name: str | None = None
    meaning: BaseUnit | None = None

    def __str__(self) -> str:
        """Return the name, with the definition where there is one: two FMUs may define a name differently."""
        return f"{self.name} ({self.meaning})" if self.meaning else str(self.name)

    def to(self, other: Unit) -> tuple[float, float] | None:
        """Return (factor, offset) that turn a value in this unit into one in ``other``; None if none can.

        A signal without unit is taken as it is. A name without a definition has the meaning that it has in Modelica.
        """
        if not self.name or not other.name:
            return 1.0, 0.0
        if self.name == other.name and (self.meaning is None or other.meaning is None):
            return 1.0, 0.0
        try:
            source, target = (unit.meaning or base_unit(unit.name or "") for unit in (self, other))
        except ModelError:
            return None
        return None if source is None or target is None else conversion(source, target)
