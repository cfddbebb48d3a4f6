"""How well `fit` finds what a log with a known truth hides: noise, parameters, and a tuning as good as the truth's.

    python -m benchmarks.fit_logs [--draws 5] [--first 0] [--rows 3000] [--plant joint …] [--kind sine …]

A fit is told half of the true noise, and order and rate of a sine at the plant's pace. The fitted observer runs beside
one that was told the truth: the noise, and the class and pace of the disturbance. A disturbance that jumps or wanders
has no declared rate; there the best of five rates counts as the truth. A second fit of the same log is told a parameter
that is 10 % off, and finds it.

Each draw is a line as soon as it is known, one of each plant and kind before the next ones; a table follows.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.estimator.ours import parameters_of
from benchmarks.estimator.plants import CYLINDER, JOINT, MOTOR, Array, Plant
from benchmarks.estimator.records import Record, simulate
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.interface.told_observer import told_observer, values_of
from ndob_fmu.log.fit.fit_log import Fitted, fit_log
from ndob_fmu.log.log import Found, Log
from ndob_fmu.log.native_run import native_run
from ndob_fmu.log.online import along
from ndob_fmu.log.told_values import ignored, told_values
from ndob_fmu.native.kept_observer import kept_observer

# Each plant with its step (s) and the parameter that is fitted.
PLANTS = {
    "joint": (JOINT, 5e-3, "motor_damping"),
    "cylinder": (CYLINDER, 2e-3, "mass"),
    "motor": (MOTOR, 1e-3, "inertia"),
}
KINDS = ("sine", "steps", "walk")
# As "steps", which are at samples, but each at any instant between two of them.
BETWEEN = "steps_between"
_RATES = (0.3, 1.0, 3.0, 10.0, 30.0)  # of D₀ per s
_TOLD_OFF, _NOISE_OFF = 1.1, 0.5
_STEADY_FROM = 0.1
_ROUNDED = 1e-9  # of a step, by which a sample's time may be off
_NOISE_WITHIN, _MOST_RATIO = 0.05, 1.1


def disturbance(plant: Plant, kind: str, seed: int, times: Array) -> Array:
    """Return a disturbance (K,) of one class at times (K,)."""
    random, D = np.random.default_rng([seed, 7]), float(plant.bounds[0])
    if kind == "sine":
        return 0.5 * D * np.sin(2.0 * np.pi * plant.pace * random.uniform(0.7, 1.3) * times + random.uniform(0.0, 6.0))
    if kind == "steps":
        return _steps(plant, seed, float(times[-1]))(times)
    walk = np.cumsum(random.standard_normal(len(times))) * 0.2 * D * np.sqrt(times[1])
    return walk - walk.mean()


def _steps(plant: Plant, seed: int, stop_time: float) -> Callable[[Any], Any]:
    """Return a disturbance of steps, as a function of time."""
    random, D = np.random.default_rng([seed, 7]), float(plant.bounds[0])
    ends = np.cumsum(random.exponential(0.5, size=int(4.0 * stop_time) + 8))
    levels = D * random.uniform(-0.6, 0.6, len(ends) + 1)
    return lambda t: levels[np.searchsorted(ends, t)]


def record_of(plant: Plant, kind: str, seed: int, H: float, rows: int) -> Record:
    """Return a record with a disturbance of a class, held over each step unless it jumps between samples."""
    if kind == BETWEEN:
        return simulate(plant, H, [seed], _steps(plant, seed, rows * H), stop_time=rows * H)
    values = disturbance(plant, kind, seed, H * np.arange(rows + 1))
    return simulate(plant, H, [seed], lambda t: values[min(int(t / H + _ROUNDED), rows)], stop_time=rows * H)


def write_log(record: Record, path: Path) -> Path:
    """Write a record as a log."""
    model = record.plant.model()
    columns = np.column_stack([record.t, record.U[0], record.Y[0]]).tolist()
    lines = [",".join(["time", *model.inputs, *model.outputs]), *(",".join(map(repr, row)) for row in columns)]
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


@dataclass(frozen=True)
class Draw:
    """What was found in one log.

    noise_off: of the output whose noise is found worst, over the true one
    ratio: error of the fitted observer over that of the one told the truth
    z: error of the parameter in its own error bars, None where the log does not tell it
    order, jumps: of the class that was found
    rate: that was found, in D₀ per s^order
    """

    plant: str
    kind: str
    seed: int
    noise_off: float
    ratio: float
    z: float | None
    order: int
    jumps: bool
    rate: float


def error(record: Record, values: Mapping[str, Any], native: Path) -> float:
    """Return the RMS of d̂ at the sample, in D₀, of an observer told some values."""
    model = record.plant.model()
    eq = compile_model(model)
    told = told_values(eq, parameters_of(record.plant, **values))
    observer = told_observer(eq, told.__getitem__, ignored)
    x_hat = values_of(told.__getitem__, eq.states, "_hat_start")
    log = Log(record.t, record.U[0], record.Y[0], Found())
    with native_run(model, native, told, observer, x_hat, len(record.t)) as run:
        (found,) = along(observer, x_hat, iter([log]), run)
    first = int(_STEADY_FROM * len(record.t))
    return float(np.sqrt(np.mean((found.online.d_at_sample - record.d)[first:] ** 2)) / record.plant.bounds[0])


def of_the_truth(record: Record, kind: str, native: Path) -> float:
    """Return the error of the observer that is told the truth."""
    plant, name = record.plant, "disturbance_rate"
    if kind == "sine":
        return error(record, {"disturbance_order": 2}, native)
    D = float(plant.bounds[0])
    return min(error(record, {"disturbance_order": 1, name: rate * D}, native) for rate in _RATES)


def fitted(record: Record, free: Sequence[str], native: Path) -> Fitted:
    """Return what `fit` finds in a record, with free parameters that are told wrongly."""
    plant, model = record.plant, record.plant.model()
    told = parameters_of(plant)
    told |= {f"{name}_noise_std": _NOISE_OFF * s for name, s in zip(model.outputs, plant.sigma, strict=True)}
    told |= {name: _TOLD_OFF * model.parameters[name] for name in free}
    with tempfile.TemporaryDirectory() as folder:
        log = write_log(record, Path(folder, "log.csv"))
        return fit_log(model, log, Path(folder, "out"), free=free, start_values=told, native=native)


def drawn(name: str, kind: str, seed: int, rows: int, native: Path) -> Draw:
    """Return what is found in a log of a plant with a disturbance of a class."""
    plant, H, free = PLANTS[name]
    record = record_of(plant, kind, seed, H, rows)
    found = fitted(record, [], native)
    off = [one.value / s - 1.0 for one, s in zip(found.noise_std.values(), plant.sigma, strict=True)]
    one = fitted(record, [free], native).parameters.get(free)
    return Draw(
        plant=name,
        kind=kind,
        seed=seed,
        noise_off=max(off, key=abs),
        ratio=error(record, found.start_values, native) / of_the_truth(record, kind, native),
        z=None if one is None else (one.value - plant.model().parameters[free]) / one.std,
        order=found.order,
        jumps=found.is_jumping,
        rate=found.start_values["disturbance_rate"] / float(plant.bounds[0]),
    )


def table(draws: Sequence[Draw]) -> str:
    """Return the shares of each plant and kind, and of all."""
    lines = ["plant kind: draws; noise within 5 %; ratio ≤ 1.1 (largest); parameter within two error bars (mean z)"]
    cells = {f"{one.plant} {one.kind}": [other for other in draws if _cell(other) == _cell(one)] for one in draws}
    for name, some in {**cells, "all": draws}.items():
        z = np.array([one.z for one in some if one.z is not None])
        lines.append(
            f"{name}: {len(some)}; {sum(abs(one.noise_off) <= _NOISE_WITHIN for one in some)}; "
            f"{sum(one.ratio <= _MOST_RATIO for one in some)} ({max(one.ratio for one in some):.2f}); "
            f"{np.sum(np.abs(z) <= 2.0)} of {len(z)} ({z.mean() if len(z) else np.nan:.2f})"
        )
    return "\n".join(lines)


def _cell(draw: Draw) -> tuple[str, str]:
    return draw.plant, draw.kind


def main() -> None:
    """Print a line for each draw and the shares over all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=5, help="of each plant and kind")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--rows", type=int, default=3000)
    parser.add_argument("--plant", nargs="+", default=list(PLANTS), choices=list(PLANTS))
    parser.add_argument("--kind", nargs="+", default=list(KINDS), choices=[*KINDS, BETWEEN])
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.draws)
    draws = []
    print(",".join(one.name for one in fields(Draw)), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in options.plant:
            kept_observer(PLANTS[name][0].model(), Path(folder), builds=True)
        for seed, name, kind in product(seeds, options.plant, options.kind):
            draws.append(drawn(name, kind, seed, options.rows, Path(folder)))
            values = (getattr(draws[-1], one.name) for one in fields(Draw))
            print(*(f"{v:.4g}" if isinstance(v, float) else v for v in values), sep=",", flush=True)
    print(table(draws))


if __name__ == "__main__":
    main()
