"""The rows of the estimator's requirements: which there are, and how they are measured in parallel."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.estimator import clean_rows, fault_rows, gallery_rows, model_files, sensor_rows, statement_rows
from benchmarks.estimator.figures import Figure
from benchmarks.estimator.tasks import Seeds, Task

Parallel = Callable[[str, Sequence[tuple[Any, ...]], int], list[Any]]


def tasks(pattern: str = "") -> list[Task]:
    """Return the tasks whose name contains the regular expression."""
    groups = (clean_rows, fault_rows, statement_rows, sensor_rows, gallery_rows)
    return [task for group in groups for task in group.tasks() if re.search(pattern, task.name)]


def measured(pattern: str, seeds: Sequence[int], in_parallel: Parallel, workers: int) -> list[Figure]:
    """Return the figures of all tasks whose name contains the regular expression."""
    jobs = [(_run_named, task.name, tuple(seeds)) for task in tasks(pattern)]
    found = [figure for figures in in_parallel("estimator", jobs, workers) for figure in figures]
    return [*found, *clean_rows.together(found)]


def measured_models(paths: Sequence[str], seeds: Sequence[int], in_parallel: Parallel, workers: int) -> list[Figure]:
    """Return the figures of model files."""
    jobs = [(model_files.beside_the_filter, tuple(seeds), path) for path in paths]
    return [figure for figures in in_parallel("models", jobs, workers) for figure in figures]


def _run_named(name: str, seeds: Seeds) -> list[Figure]:
    # A worker gets the name, because plants and faults have functions that cannot be pickled.
    return next(task for task in tasks() if task.name == name).run(seeds)
