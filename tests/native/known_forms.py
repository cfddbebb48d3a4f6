"""Forms of Python whose meaning is easily lost in C, one in each function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError

TABLE = {"half": 0.5, "whole": 1.0}


def _fails(x: float) -> bool:
    if x < 0.0:
        raise np.linalg.LinAlgError
    return x > 1.0


def stops_at_the_first_that_decides(x: float, guard: bool) -> bool:
    return guard and _fails(x)


def stops_at_the_first_that_holds(x: float, guard: bool) -> bool:
    return guard or _fails(x)


def takes_one_branch(x: float, guard: bool) -> float:
    return 2.0 if guard else float(_fails(x))


def is_between(low: float, x: float, high: float) -> bool:
    return low <= x < high


def keeps_a_view(x: Array) -> Array:
    rows = x.copy()
    row = rows[1]
    rows[1, 0] = 7.0
    return row


def carries_over_a_loop(A: Array, count: int) -> Array:
    total, power = np.zeros(A.shape), np.eye(len(A))
    for k in range(count):
        if k == 2:
            continue
        power = power @ A
        total = total + power
    return total


def collects(x: Array) -> list[float]:
    found = []
    for i, value in enumerate(x.tolist()):
        if value > 0.0:
            found.append(value * i)
    return found


def floor_and_rest(x: int, y: int) -> list[int]:
    return [x // y, x % y]


def largest_of(x: float, y: float) -> list[float]:
    return [max(x, y), min(x, y)]


def tries(x: float) -> float:
    result = 1.0
    try:
        result = 2.0
        if _fails(x):
            result = 3.0
    except np.linalg.LinAlgError:
        result = result + 10.0
    return result


def calls_inside(x: Array, shift: float) -> float:
    scale = 2.0

    def moved(value: float) -> float:
        return scale * value + shift

    return sum(moved(value) for value in x.tolist())


def singular_values(x: Array) -> Array:
    return np.linalg.svd(x)[1]


def made_again(x: Array) -> Array:
    U, s, Vt = np.linalg.svd(x, full_matrices=False)
    return (U * s) @ Vt


def is_orthogonal(x: Array) -> list[float]:
    U, _, Vt = np.linalg.svd(x)
    return [
        float(np.linalg.norm(U.T @ U - np.eye(U.shape[1]))),
        float(np.linalg.norm(Vt @ Vt.T - np.eye(len(Vt)))),
    ]


def of_symmetric(x: Array) -> Array:
    values, V = np.linalg.eigh(x + x.T)
    return (V * values) @ V.T


def solution(A: Array, b: Array) -> Array:
    return np.linalg.lstsq(A, b, rcond=None)[0]


def inverse(A: Array) -> Array:
    return np.linalg.pinv(A)


def norms(A: Array) -> list[float]:
    return [float(np.linalg.norm(A)), float(np.linalg.norm(A, 1)), float(np.linalg.norm(A, 2))]


def basis(A: Array) -> Array:
    return np.abs(np.linalg.qr(A)[0])


@dataclass(frozen=True)
class Line:
    slope: float

    def __call__(self, x: float) -> float:
        return self.slope * x


def calls_a_value(x: float) -> float:
    line = Line(TABLE["half"])
    return line(x)


def is_one_of(x: int) -> bool:
    return x in (1, 4)


def is_none_of(x: int) -> bool:
    return x not in (1, 4)


def place_of(name: str, names: Sequence[str]) -> int:
    return names.index(name) if name in names else -1


def _refuses(x: float) -> float:
    if x < 0.0:
        raise DesignError(f"{x:g} is below 0")
    return x


def says_why(x: float) -> float:
    try:
        return _refuses(x)
    except DesignError as error:
        raise DesignError(f"no answer ({error})") from None
