"""Remember the last result of a costly function: a memo of values, never of the past of a simulation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar, cast

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
