"""Ratios of times on a busy machine: the compared programs take turns, each round gives a ratio, the median counts."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from time import process_time

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.float64]


def take_turns(actions: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, Times]:
    """Return the processor time of each action in each round (s); they take turns, in a rotating order.

    Time on the clock would include other work on the machine.
    """
    found: dict[str, list[float]] = {name: [] for name in actions}
    order = list(actions)
    gc.collect()
    for _ in range(rounds):
        order.append(order.pop(0))
        for name in order:
            begin = process_time()
            actions[name]()
            found[name].append(process_time() - begin)
    return {name: np.array(times) for name, times in found.items()}


def ratio(ours: Times, theirs: Times) -> tuple[float, float, float]:
    """Return the median of the ratios of the rounds, and their quartiles."""
    low, middle, high = np.percentile(ours / theirs, [25.0, 50.0, 75.0])
    return float(middle), float(low), float(high)
