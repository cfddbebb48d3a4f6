"""Forms that the translator must refuse, one in each function."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ndob_fmu.runtime.arrays import Array


def yields(n: int) -> Iterator[int]:
    yield from range(n)


def calls_what_is_unknown(x: Array) -> Array:
    return np.unique(x)


def changes_an_argument(x: Array) -> float:
    x[0] = 1.0
    return float(x[0])


def changes_a_type(n: int) -> float:
    value = n
    value = [1.0, 2.0]  # type: ignore[assignment]
    return float(value)  # type: ignore[arg-type]


def takes_any(*values: float) -> float:
    return values[0]


def steps_over(x: Array) -> Array:
    return x[::2]


def catches_all(x: Array) -> Array:
    try:
        return np.linalg.inv(x)
    except Exception:
        return x
