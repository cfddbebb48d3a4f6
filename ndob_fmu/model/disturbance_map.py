"""The part of a disturbance that is a function of the states: friction, and what depends on the place.

What acts on the plant is map(x) + d, where an observer estimates d:

    map(x) = offset + Σ odd_k tanh(v/v_k) + Σ even_k tanh²(v/v_k) + Σ (place_j + signed_j tanh(v/v_5)) tanh((z − z_j)/w)

Friction is a function of a rate v, on scales v_k = scale/4^(k−1) that become finer towards standstill. z is a state
with steps z_j, w apart, between `low` and `high`. Beyond them the map stays as it is at the end. The coefficients are
parameters of the model. With 0, their start value, there is no map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from ndob_fmu.errors import ModelError, some_of
from ndob_fmu.model.checks import require_known

FRICTION, PLACE = "friction", "place"
_SCALES, _RATIO, _STEPS = 5, 4, 8
# Where a map looks, until a log tells: the scale of a rate, and the ends of a place.
_SCALE, _LOW, _HIGH = 1.0, -1.0, 1.0


@dataclass(frozen=True)
class MapPart:
    """Terms of a map that belong together.

    name: what they stand for
    terms: each coefficient with its function of the states
    """

    name: str
    terms: Mapping[str, sympy.Expr]


@dataclass(frozen=True)
class DisturbanceMap:
    """The map of a disturbance.

    offset: the coefficient of 1
    parts: the other coefficients, in the order in which a log is asked for them
    rates: for each rate the parameter that says its scale
    places: for each place the parameters that say its ends
    """

    disturbance: str
    offset: str
    parts: tuple[MapPart, ...]
    rates: Mapping[str, str]
    places: Mapping[str, tuple[str, str]]

    @property
    def coefficients(self) -> tuple[str, ...]:
        """All coefficients, the offset first."""
        return (self.offset, *(name for part in self.parts for name in part.terms))

    @property
    def functions(self) -> tuple[sympy.Expr, ...]:
        """The functions of the states that belong to the coefficients."""
        return (sympy.S.One, *(function for part in self.parts for function in part.terms.values()))

    @property
    def expression(self) -> sympy.Expr:
        """The map in the symbols of states and parameters."""
        return sympy.Add(*(_symbol(name) * one for name, one in zip(self.coefficients, self.functions, strict=True)))

    @property
    def parameters(self) -> dict[str, float]:
        """The start value of each parameter."""
        ends = {name: value for pair in self.places.values() for name, value in zip(pair, (_LOW, _HIGH), strict=True)}
        return {**dict.fromkeys(self.coefficients, 0.0), **dict.fromkeys(self.rates.values(), _SCALE), **ends}

    @property
    def like(self) -> dict[str, str]:
        """For each parameter the variable whose unit it has."""
        of_rates = {name: rate for rate, name in self.rates.items()}
        of_places = {name: place for place, pair in self.places.items() for name in pair}
        return {**dict.fromkeys(self.coefficients, self.disturbance), **of_rates, **of_places}

    @property
    def descriptions(self) -> dict[str, str]:
        """What each parameter is."""
        return {
            **dict.fromkeys(self.coefficients, f"Coefficient of the map of {self.disturbance}"),
            **{name: f"Largest {rate} in the map of {self.disturbance}" for rate, name in self.rates.items()},
            **{
                name: f"{end} {place} in the map of {self.disturbance}"
                for place, pair in self.places.items()
                for name, end in zip(pair, ("Lowest", "Highest"), strict=True)
            },
        }


def read_maps(model: str, told: Any, states: Sequence[str], disturbances: Sequence[str]) -> tuple[DisturbanceMap, ...]:
    """Return the maps for {disturbance: {state: "friction" or "place"}}; `model`: its name, for messages.

    Raises ModelError.
    """
    where = f"{model}.disturbance_map"
    if not isinstance(told, Mapping) or not all(isinstance(kinds, Mapping) and kinds for kinds in told.values()):
        raise ModelError.report(
            where, expected='{disturbance: {state: "friction" or "place"}}', received=repr(told), likely="a list"
        )
    require_known(where, told, disturbances)
    maps = []
    for disturbance, kinds in told.items():
        require_known(f"{where}, {disturbance}", kinds, states)
        for state, kind in kinds.items():
            if kind not in (FRICTION, PLACE):
                raise ModelError.report(f"{where}, {state}", expected=f"{FRICTION!r} or {PLACE!r}", received=repr(kind))
        rates = [state for state, kind in kinds.items() if kind == FRICTION]
        if len(rates) > 1:
            raise ModelError.report(
                f"{where}, {disturbance}",
                expected="one rate with friction",
                received=some_of(rates, between=" and "),
                likely="friction of each axis acts as a disturbance of its own",
            )
        maps.append(_map(disturbance, rates, [state for state, kind in kinds.items() if kind == PLACE]))
    return tuple(maps)


def _map(disturbance: str, rates: Sequence[str], places: Sequence[str]) -> DisturbanceMap:
    prefix = f"{disturbance}_map"
    parts, finest = [], None
    for rate in rates:
        scaled = [_symbol(rate) * _RATIO**k / _symbol(f"{prefix}_{rate}_scale") for k in range(_SCALES)]
        finest = sympy.tanh(scaled[-1])
        odd = {f"{prefix}_{rate}_odd_{k}": sympy.tanh(one) for k, one in enumerate(scaled, 1)}
        even = {f"{prefix}_{rate}_even_{k}": sympy.tanh(one) ** 2 for k, one in enumerate(scaled, 1)}
        parts.append(MapPart(f"friction of {rate}", {**odd, **even}))
    ends = {place: (f"{prefix}_{place}_low", f"{prefix}_{place}_high") for place in places}
    for place, pair in ends.items():
        low, high = map(_symbol, pair)
        # tanh of (z − z_j)/w with w = (high − low)/n and z_j = low + (j − ½) w
        along = _STEPS * (_symbol(place) - low) / (high - low)
        steps = [sympy.tanh(along - sympy.Rational(2 * j - 1, 2)) for j in range(1, _STEPS + 1)]
        parts.append(MapPart(place, {f"{prefix}_{place}_{j}": one for j, one in enumerate(steps, 1)}))
        if finest is not None:
            signed = {f"{prefix}_{place}_signed_{j}": finest * one for j, one in enumerate(steps, 1)}
            parts.append(MapPart(f"{place} and direction", signed))
    scales = {rate: f"{prefix}_{rate}_scale" for rate in rates}
    return DisturbanceMap(disturbance, f"{prefix}_offset", tuple(parts), scales, ends)


def _symbol(name: str) -> sympy.Symbol:
    """Return the symbol that a model has for a name."""
    return sympy.Symbol(name, real=True)
