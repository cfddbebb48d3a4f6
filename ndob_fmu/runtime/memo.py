"""Remember results of costly functions: a memo of values, never of the past of a simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any, Generic, TypeVar, cast

import numpy as np

T = TypeVar("T")


class Latest(Generic[T]):
    """The last result of a function, `value`, and the arguments that it holds for; None before the first one."""

    def __init__(self) -> None:
        self._key: tuple[float, ...] | None = None
        self.value: T | None = None

    def __call__(self, key: tuple[float, ...], compute: Callable[[], T]) -> T:
        """Return the value for `key`, computed only if the last one was for another."""
        if key != self._key:
            self.value = compute()
            self._key = key
        return cast(T, self.value)


class Shared(Generic[T]):
    """The results of a function for the last `size` keys that were asked for, by any instance in the process.

    A key holds the values of all that the result depends on (`by_value`). The arrays of a result are read-only.
    """

    def __init__(self, size: int) -> None:
        self._answer = lru_cache(maxsize=size)(_answer)

    def __call__(self, key: tuple[Any, ...], compute: Callable[[], T]) -> T:
        """Return the value for `key`, computed only where it is not at hand."""
        return cast(T, self._answer(_Question(key, compute)))


class _Question:
    """A key, and how to find its value as long as that is not known."""

    __slots__ = ("compute", "key")

    def __init__(self, key: tuple[Any, ...], compute: Callable[[], Any]) -> None:
        self.key, self.compute = key, compute

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Question) and self.key == other.key


def _answer(question: _Question) -> Any:
    value = question.compute()
    del question.compute  # the memo keeps the question, which need not keep an observer
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
    """Return what is equal, and has the same hash, for things of the same values to the last bit."""
    if isinstance(thing, np.ndarray):
        return thing.shape, thing.dtype.str, thing.tobytes()
    if isinstance(thing, (tuple, list)):
        return tuple(map(by_value, thing))
    if is_dataclass(thing):
        return type(thing).__name__, *(by_value(getattr(thing, field.name)) for field in fields(thing))
    return thing.hex() if isinstance(thing, float) else thing
