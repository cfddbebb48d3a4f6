"""The observer along a log by a native FMU of the same model: many rows in one call."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import fields, is_dataclass
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ndob_fmu.log.log import Log
from ndob_fmu.log.online import Online, parts_of_steps, sampled
from ndob_fmu.model.model import Model
from ndob_fmu.native.many_steps import NativeObserver, native_observer
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.intensity_law import IntensityLaw
from ndob_fmu.runtime.design.stationary_design import Intensities
from ndob_fmu.runtime.equations import Vector
from ndob_fmu.runtime.step.observer import Observer
from ndob_fmu.runtime.step.sampled_observer import SampledObserver

# Steps whose results are in memory at once, but for those over one gap.
_AT_ONCE = 20_000
# Rows whose steps in Python take about as long as a build.
_WORTH_A_BUILD = 10_000

PYTHON, NATIVE = "Python", "native"


class NativeRun:
    """Takes the steps of an observer by its native twin, which has the same parameters: `online.Run`."""

    def __init__(self, observer: Observer[Any], x_hat: Vector, native: NativeObserver) -> None:
        self._native, self._observer, first = native, observer, sampled(observer.init(x_hat))
        places = _numbered(first, count())
        sensors = places.memory.sensors
        self._tuned_at, self._is_tuned = places.memory.tuned_at, False
        self._read = np.array(
            [*places.xi_hat, *(one.noise_ratio for one in sensors), *(one.refused for one in sensors)], dtype=np.uint32
        )
        self._states, self._size = len(x_hat), len(first.xi_hat)
        self._before = np.array([*first.xi_hat, *(one.noise_ratio for one in first.memory.sensors)], dtype=float)

    def __call__(self, log: Log, step: Array, usual: float) -> Online:
        """Return what the observer says along the next rows."""
        parts = parts_of_steps(log, step, usual)
        groups = np.flatnonzero(np.diff(np.cumsum(parts) // _AT_ONCE)) + 1
        said, after = [], []
        for rows in np.split(np.arange(len(step)), groups):
            given = {} if self._is_tuned else {self._tuned_at: usual}
            each = np.repeat(rows, parts[rows])
            ends = np.cumsum(parts[rows])
            begins = ends - parts[rows]
            inputs = np.column_stack([log.inputs[each], np.full((len(each), log.outputs.shape[1]), np.nan)])
            inputs[begins, log.inputs.shape[1] :] = log.outputs[rows]
            outputs, numbers = self._native.steps((step / parts)[each], inputs, self._read, given)
            if not self._is_tuned:
                self._share_tuning(usual)
            self._is_tuned = True
            said.append(outputs[begins])
            after.append(numbers[ends - 1])
        return self._online(np.concatenate(said), np.concatenate(after), np.isnan(log.outputs))

    def _share_tuning(self, usual: float) -> None:
        """Give the observer in Python the tuning of its native twin, which the smoother needs."""
        H, *others = self._native.tuning() or [0.0]
        if usual != H or not isinstance(self._observer, SampledObserver):
            return
        q, numbers = self._observer.layout.q, np.array(others[1:])
        of_d, of_f, (scale,), law, limit, (law_at, exponent, limit_exponent) = np.split(
            numbers, [q, len(numbers) - 4 - 2 * q, len(numbers) - 3 - 2 * q, len(numbers) - 3 - q, len(numbers) - 3]
        )
        self._observer.take_tuning(
            H,
            Intensities(of_d, of_f, float(scale)),
            IntensityLaw(law, limit, float(law_at), float(exponent), float(limit_exponent)),
            freezes=bool(others[0]),
        )

    def _online(self, outputs: Array, after: Array, missing: Array) -> Online:
        """Return it from the outputs of the FMU (K,·) and the numbers of its state behind each step (K,·)."""
        n, p = self._states, missing.shape[1]
        q = (outputs.shape[1] - n - 2 * p - 2) // 5
        ends = np.cumsum([n, q, q, q, q, q, p, p, 1])
        x_hat, d_hat, d_at_sample, d_std, d_lagged, d_lagged_std, residual, residual_std, valid, consistency = np.split(
            outputs, ends, axis=1
        )
        before = np.concatenate([self._before[None], after[:-1, : self._size + p]])
        self._before = after[-1, : self._size + p]
        return Online(
            predicted=before[:, : self._size],
            x_hat=x_hat,
            d_hat=d_hat,
            d_at_sample=d_at_sample,
            d_std=d_std,
            d_lagged=d_lagged,
            d_lagged_std=d_lagged_std,
            residual=np.where(missing, np.nan, residual),
            residual_std=residual_std,
            noise_ratio=before[:, self._size :],
            refused=after[:, self._size + p :],
            valid=valid[:, 0],
            consistency=consistency[:, 0],
        )


@contextmanager
def native_run(
    model: Model, folder: Path | None, values: Mapping[str, Any], observer: Observer[Any], x_hat: Vector, rows: int
) -> Iterator[NativeRun | None]:
    """Yield what takes the steps of an observer of a model from x̂₀ (n,), by a native FMU in a folder or that is kept.

    values: of all parameters, which the observer has
    rows: how many there are at least, along all of which observers of the model run; for many of them one is built

    It is None where `native_observer` finds no FMU, and without a folder.
    """
    builds = rows >= _WORTH_A_BUILD
    with nullcontext() if folder is None else native_observer(model, folder, values, builds=builds) as native:
        yield None if native is None else NativeRun(observer, x_hat, native)


def build_of(run: NativeRun | None) -> str:
    """Return what the steps of an observer are taken by, PYTHON or NATIVE."""
    return PYTHON if run is None else NATIVE


def _numbered(value: Any, places: Iterator[int]) -> Any:
    """Return a part of the state with the place of each of its numbers, where they are written one behind the other."""
    if is_dataclass(value):
        return SimpleNamespace(**{one.name: _numbered(getattr(value, one.name), places) for one in fields(value)})
    if isinstance(value, tuple):
        return [_numbered(one, places) for one in value]
    if isinstance(value, np.ndarray):
        return [next(places) for _ in range(value.size)]
    return next(places)
