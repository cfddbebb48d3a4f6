"""Checks of what a user writes in a model: names, texts and numbers. Each raises ModelError with one line."""

from __future__ import annotations

import keyword
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from ndob_fmu.errors import ModelError, nearest, one_of, some_of

# What XML 1.0 cannot carry, not even escaped.
_NO_TEXT = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def require_names(where: str, names: object, *, may_be_empty: bool) -> tuple[str, ...]:
    """Return a list of names as a tuple; what the names look like is judged by `require_distinct_names`."""
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise ModelError.report(where, expected="a list of names", received=repr(names))
    found = tuple(names)
    if not found and not may_be_empty:
        raise ModelError.report(where, expected="at least one name", received="none")
    return found


def require_identifier(where: str, name: Any) -> None:
    """Require a name that both Python's attributes and FMI's variables can have."""
    plain = isinstance(name, str) and name.isidentifier() and name.isascii() and not name.startswith("_")
    if not plain or keyword.iskeyword(name):
        raise ModelError.report(
            where,
            expected="a name of ASCII letters, digits and underscores that starts with a letter and is no keyword of "
            "Python",
            received=repr(name),
            likely=f"x.{name} cannot be written in Python; {name}_ can" if plain else "",
        )


def require_distinct_names(
    model: str, groups: Mapping[str, Iterable[str]], outputs: Sequence[str], reserved: Iterable[str]
) -> tuple[str, ...]:
    """Return all names, each once.

    groups: states, inputs, disturbances and parameters, which share no name
    outputs: may have the name of the state that they measure
    reserved: names that the FMUs use themselves, twice where they derive from two of the model's
    """
    seen: dict[str, str] = {}
    for group, names in groups.items():
        for name in names:
            require_identifier(f"{model}.{group}", name)
            if name in seen:
                raise ModelError.report(
                    f"{model}.{group}",
                    expected="every name once among states, inputs, disturbances and parameters",
                    received=f"{name!r}, which is also in {seen[name]}",
                )
            seen[name] = group
    for name in outputs:
        require_identifier(f"{model}.outputs", name)
        if outputs.count(name) > 1 or seen.get(name, "states") != "states":
            raise ModelError.report(
                f"{model}.outputs",
                expected="names used once, or the name of the state that is measured",
                received=f"{name!r}, which is also in {seen.get(name, 'outputs')}",
            )
    derived = Counter(reserved)
    for name, count in derived.items():
        if count > 1:
            raise ModelError.report(
                model,
                expected="names from which the FMUs derive different ones",
                received=f"two from which they derive {name!r}",
                likely=f"{name.rpartition('_')[0]!r} needs another name",
            )
    for name in [*seen, *outputs]:
        if name in derived:
            raise ModelError.report(model, expected="names that the FMUs do not use themselves", received=repr(name))
    return tuple(dict.fromkeys([*seen, *outputs]))


def require_known(where: str, names: Iterable[str], known: Iterable[str]) -> None:
    """Require that every name is one of the model's."""
    own = sorted(known)
    for name in names:
        if name not in own:
            raise ModelError.report(
                where, expected=one_of("name", own, name), received=repr(name), likely=nearest(name, own)
            )


def require_text(where: str, text: object) -> None:
    """Require a text that a model description can carry."""
    if not isinstance(text, str) or _NO_TEXT.search(text):
        raise ModelError.report(where, expected="characters that XML can carry", received=repr(text))


def require_finite(where: str, value: object) -> None:
    """Require a finite number."""
    if not is_finite_number(value):
        raise ModelError.report(where, expected="a finite number", received=repr(value))


def require_not_negative(where: str, value: object, unit: str = "") -> None:
    """Require a finite number ≥ 0."""
    if not (is_finite_number(value) and value >= 0):  # type: ignore[operator]
        raise ModelError.report(where, expected=f"a finite number ≥ 0{unit}", received=repr(value))


def require_numbers(where: str, value: Any, count: int, *, positive: bool = False) -> tuple[float, ...]:
    """Return as many finite numbers as a tuple; `positive`: all of them > 0."""
    numbers = tuple(value) if isinstance(value, Iterable) else ()
    usable = all(is_finite_number(v) and (v > 0 or not positive) for v in numbers)
    if len(numbers) != count or not usable:
        expected = f"{count} finite numbers" + (" > 0" if positive else "")
        raise ModelError.report(where, expected=expected, received=repr(value))
    return tuple(float(v) for v in numbers)


def require_bounds(
    where: str, value: Any, count: int, *, of: str = "disturbance", positive: bool = False
) -> tuple[float, ...]:
    """Return `count` finite numbers ≥ 0, one for each `of`; one number counts for all. `positive`: all of them > 0."""
    numbers = tuple(value) if isinstance(value, Iterable) else (value,)
    usable = all(is_finite_number(v) and (v > 0 if positive else v >= 0) for v in numbers)
    if len(numbers) not in (1, count) or not usable:
        expected = f"one finite number {'>' if positive else '≥'} 0"
        each = f", or {count}, one for each {of}" if count > 1 else ""
        raise ModelError.report(where, expected=expected + each, received=repr(value))
    return tuple(map(float, numbers)) * (count // len(numbers))


def require_no_channel(model: str, given: Mapping[str, bool]) -> None:
    """Refuse the fields that belong to a channel, where there is none; `given`: whether each is set."""
    for field, is_set in given.items():
        if is_set:
            raise ModelError.report(f"{model}.{field}", expected="a channel that it belongs to", received="no channel")


def require_one_disturbance(model: str, disturbances: Sequence[str]) -> None:
    """Require a single disturbance, which a channel belongs to."""
    if len(disturbances) != 1:
        raise ModelError.report(
            f"{model}.disturbances",
            expected="one disturbance where there is a channel",
            received=f"{len(disturbances)}: {some_of(disturbances)}",
            likely="the channel belongs to one of them; give the others constant columns in a model of their own",
        )


def require_ranges(where: str, ranges: object, starts: Mapping[str, Sequence[float]], inputs: Sequence[str]) -> Any:
    """Return the ranges as {name: (lowest, highest)}.

    starts: for each state its start values, which must lie within its range
    """
    if not isinstance(ranges, Mapping):
        raise ModelError.report(
            where, expected="{state or input: (lowest, highest)}", received=repr(ranges), likely="a list without names"
        )
    require_known(where, ranges, [*starts, *inputs])
    found = {}
    for name, value in ranges.items():
        pair = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else ()
        if len(pair) != 2 or not all(map(is_finite_number, pair)) or not pair[0] < pair[1]:
            raise ModelError.report(
                f"{where}, {name}",
                expected="(lowest, highest), two finite numbers in this order",
                received=repr(value),
                likely="the two are the same or exchanged",
            )
        low, high = found[name] = (float(pair[0]), float(pair[1]))
        for start in starts.get(name, ()):
            if not low <= start <= high:
                raise ModelError.report(
                    f"{where}, {name}",
                    expected="a range that holds the start values x0 and xhat0",
                    received=f"({low:g}, {high:g}) and a start value of {start:g}",
                    likely="x0 is left out, and is 0 then, or the range is too narrow",
                )
    return MappingProxyType(found)


def is_finite_number(value: Any) -> bool:
    """Return whether the value is a number, and finite."""
    try:
        return math.isfinite(value)
    except TypeError:
        return False


def by_name(where: str, value: Any, names: Sequence[str], default: Sequence[float]) -> tuple[Any, ...]:
    """Return a value for each name.

    value: one number for all, or a mapping; what a mapping lacks has its `default`
    """
    if isinstance(value, Mapping):
        require_known(where, value, names)
        return tuple(value.get(name, other) for name, other in zip(names, default, strict=True))
    if not is_finite_number(value):
        raise ModelError.report(
            where, expected=f"one number, or {{name: number}} with names of {some_of(names)}", received=repr(value)
        )
    return (value,) * len(names)


def listed(where: str, value: Any, names: Sequence[str], default: Sequence[float]) -> Any:
    """Return a mapping as the values of the names in their order, all else as it is."""
    return by_name(where, value, names, default) if isinstance(value, Mapping) else value


def for_each(count: int, value: Any) -> Any:
    """Return one number as a list of `count` equal ones, all else as it is."""
    return [value] * count if is_finite_number(value) else value
