"""How well `fit` finds what a log with a known truth hides: noise, parameters, and a tuning as good as the truth's.

    python -m benchmarks.fit_logs [--draws 40] [--rows 3000] [--plant joint …] [--kind sine …]

A fit is told half of the true noise, and order and rate of a sine at the plant's pace. The fitted observer runs beside
one that was told the truth: the noise, and the class and pace of the disturbance. A disturbance that jumps or wanders
has no declared rate; there the best of five rates counts as the truth. A second fit of the same log is told a parameter
that is 10 % off, and finds it.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.estimator.ours import ours, parameters_of
from benchmarks.estimator.plants import CYLINDER, JOINT, MOTOR, Array, Plant
from benchmarks.estimator.records import Record, simulate
from ndob_fmu.log.fit.fit_log import Fitted, fit_log

# Each plant with its step (s) and the parameter that is fitted.
PLANTS = {
    "joint": (JOINT, 5e-3, "motor_damping"),
    "cylinder": (CYLINDER, 2e-3, "mass"),
    "motor": (MOTOR, 1e-3, "inertia"),
}
KINDS = ("sine", "steps", "walk")
_RATES = (0.3, 1.0, 3.0, 10.0, 30.0)  # of D₀ per s
_TOLD_OFF, _NOISE_OFF = 1.1, 0.5
_STEADY_FROM = 0.1


def disturbance(plant: Plant, kind: str, seed: int, times: Array) -> Array:
    """Return a disturbance (K,) of one class at times (K,)."""
    random, D = np.random.default_rng([seed, 7]), float(plant.bounds[0])
    if kind == "sine":
        return 0.5 * D * np.sin(2.0 * np.pi * plant.pace * random.uniform(0.7, 1.3) * times + random.uniform(0.0, 6.0))
    if kind == "steps":
        ends = np.cumsum(random.exponential(0.5, size=int(4.0 * times[-1]) + 8))
        return D * random.uniform(-0.6, 0.6, len(ends) + 1)[np.searchsorted(ends, times)]
    walk = np.cumsum(random.standard_normal(len(times))) * 0.2 * D * np.sqrt(times[1])
    return walk - walk.mean()


def record_of(plant: Plant, kind: str, seed: int, H: float, rows: int) -> Record:
    """Return a record with a disturbance of a class, held over each step."""
    values = disturbance(plant, kind, seed, H * np.arange(rows + 1))
    return simulate(plant, H, [seed], lambda t: values[min(int(t / H + 1e-6), rows)], stop_time=rows * H)


def write_log(record: Record, path: Path) -> Path:
    """Write a record as a log."""
    model = record.plant.model()
    columns = np.column_stack([record.t, record.U[0], record.Y[0]]).tolist()
    lines = [",".join(["time", *model.inputs, *model.outputs]), *(",".join(map(repr, row)) for row in columns)]
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def error(record: Record, values: Mapping[str, Any]) -> float:
    """Return the RMS of d̂ at the sample, in D₀, of an observer told some values."""
    found = ours(record.plant, record.H, record.U[0], record.Y[0], **values)
    first = int(_STEADY_FROM * len(record.t))
    return float(np.sqrt(np.mean((found["at"] - record.d)[first:] ** 2)) / record.plant.bounds[0])


def of_the_truth(record: Record, kind: str) -> float:
    """Return the error of the observer that is told the truth."""
    plant, name = record.plant, "disturbance_rate"
    if kind == "sine":
        return error(record, {"disturbance_order": 2})
    D = float(plant.bounds[0])
    return min(error(record, {"disturbance_order": 1, name: rate * D}) for rate in _RATES)


def fitted(record: Record, free: Sequence[str]) -> Fitted:
    """Return what `fit` finds in a record, with free parameters that are told wrongly."""
    plant, model = record.plant, record.plant.model()
    told = parameters_of(plant)
    told |= {f"{name}_noise_std": _NOISE_OFF * s for name, s in zip(model.outputs, plant.sigma, strict=True)}
    told |= {name: _TOLD_OFF * model.parameters[name] for name in free}
    with tempfile.TemporaryDirectory() as folder:
        log = write_log(record, Path(folder, "log.csv"))
        return fit_log(model, log, Path(folder, "out"), free=free, start_values=told)


def line(name: str, kind: str, draws: int, rows: int) -> str:
    """Return what was found in some draws of a plant and a class."""
    plant, H, free = PLANTS[name]
    true = plant.model().parameters[free]
    off, within, ratios, classes = [], [], [], []
    for seed in range(draws):
        record = record_of(plant, kind, seed, H, rows)
        found = fitted(record, [])
        off.append([one.value / s - 1.0 for one, s in zip(found.noise_std.values(), plant.sigma, strict=True)])
        ratios.append(error(record, found.start_values) / of_the_truth(record, kind))
        classes.append(f"{found.order}{'j' if found.is_jumping else ''}")
        one = fitted(record, [free]).parameters.get(free)
        if one is not None:
            within.append(abs(one.value - true) <= 2.0 * one.std)
    share = f"{100.0 * np.mean(within):.0f} %" if within else "none"
    return (
        f"{name} {kind}: noise within {100.0 * np.max(np.abs(off)):.1f} %; error {np.median(ratios):.2f} × that of the "
        f"truth, at most {max(ratios):.2f}; {free} told {len(within)} times of {draws}, {share} within two error bars; "
        f"classes {' '.join(classes)}"
    )


def main() -> None:
    """Print a line for each draw and the shares over all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--rows", type=int, default=3000)
    parser.add_argument("--plant", nargs="+", default=list(PLANTS), choices=list(PLANTS))
    parser.add_argument("--kind", nargs="+", default=list(KINDS), choices=KINDS)
    options = parser.parse_args()
    for name in options.plant:
        for kind in options.kind:
            print(line(name, kind, options.draws, options.rows), flush=True)


if __name__ == "__main__":
    main()
