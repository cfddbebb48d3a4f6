"""Results that are computed once for each model: a model never changes, and writing its code takes seconds."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

from ndob_fmu.model.model import Model

T = TypeVar("T")


def once_per_model(function: Callable[[Model], T]) -> Callable[[Model], T]:
    """Return the function with a memory of its results, each kept as long as its model."""
    results: WeakKeyDictionary[Model, T] = WeakKeyDictionary()

    @wraps(function)
    def remembered(model: Model) -> T:
        if model not in results:
            results[model] = function(model)
        return results[model]

    return remembered
