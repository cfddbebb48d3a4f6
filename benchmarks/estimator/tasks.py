"""What a row of the estimator's requirements is measured by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from benchmarks.estimator.figures import Figure
from benchmarks.estimator.ours import NotAvailableError, RefusedError
from benchmarks.estimator.plants import PLANTS, Plant

Seeds = tuple[int, ...]


@dataclass(frozen=True)
class Task:
    """Some rows that are measured together: `function` takes the seeds of the records and the arguments."""

    name: str
    function: Callable[..., list[Figure]]
    arguments: tuple[Any, ...] = ()

    def run(self, seeds: Seeds) -> list[Figure]:
        """Return the figures; where the FMU lacks what they need, one figure that says so."""
        try:
            return self.function(seeds, *self.arguments)
        except NotAvailableError as error:
            return [Figure(self.name, float("nan"), None, note=f"not available: {error}")]
        except RefusedError as error:
            return [Figure(self.name, float("nan"), None, note=f"refused: {error}")]


def plant_of(name: str) -> Plant:
    """Return the plant of that name."""
    return next(plant for plant in PLANTS if plant.name == name)


def ms(H: float) -> str:
    """Return a time in ms as text."""
    return f"{H * 1e3:g} ms"
