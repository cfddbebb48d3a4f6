"""Caches of costly results: they depend on their key alone, never on the past of a simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any, Generic, TypeVar, cast

import numpy as np

T = TypeVar("T")


class LatestResult(Generic[T]):
    """A cache of one entry: the last result of a function, `value`, and its key; None before the first one."""

    def __init__(self) -> None:
        self._key: tuple[float, ...] | None = None
        self.value: T | None = None

    def __call__(self, key: tuple[float, ...], compute: Callable[[], T]) -> T:
        """Return the value for `key`, computed only if the last key was another."""
        if key != self._key:
            self.value = compute()
            self._key = key
        return cast(T, self.value)


class SharedResults(Generic[T]):
    """A cache of the last `size` results of a function, shared by all instances in the process.

    A key holds the values of all that the result depends on (`by_value`). The arrays of a result are read-only.
    """

    def __init__(self, size: int) -> None:
        self._answer = lru_cache(maxsize=size)(_answer)

    def __call__(self, key: tuple[Any, ...], compute: Callable[[], T]) -> T:
        """Return the value for `key`, computed only where it is not in the cache."""
        return cast(T, self._answer(_Lookup(key, compute)))


class _Lookup:
    """A key, and how to compute its value until that is known."""

    __slots__ = ("compute", "key")

    def __init__(self, key: tuple[Any, ...], compute: Callable[[], Any]) -> None:
        self.key, self.compute = key, compute

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Lookup) and self.key == other.key


def _answer(lookup: _Lookup) -> Any:
    value = lookup.compute()
    del lookup.compute  # the cache keeps the lookup, which must not keep an observer alive
    _protect(value)
    return value


def _protect(value: Any) -> None:
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, tuple):
        for item in value:
            _protect(item)
    elif is_dataclass(value):
        for field in fields(value):
            _protect(getattr(value, field.name))


def by_value(thing: Any) -> Any:
    """Return a key that is equal for things whose values are equal to the last bit."""
    if isinstance(thing, np.ndarray):
        return thing.shape, thing.dtype.str, thing.tobytes()
    if isinstance(thing, (tuple, list)):
        return tuple(map(by_value, thing))
    if is_dataclass(thing):
        return type(thing).__name__, *(by_value(getattr(thing, field.name)) for field in fields(thing))
    return thing.hex() if isinstance(thing, float) else thing
