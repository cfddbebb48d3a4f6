"""How much of the true disturbance the bands of ± 2 std hold, where the model is right and where it is 15 % off.

    python -m benchmarks.smoothed_bands [--draws 2] [--rows 3000] [--plant joint …] [--kind sine …]

A log of each class of disturbances is fitted with the right model. Then `estimate` runs along it, and along logs of
plants with one wrong parameter, of which it is told: its error is drawn from a normal distribution with a standard
deviation of 15 %. Figures are over all draws, the first and the last rows left out; std and errors are in D₀. RMS
errors also hold the rows around a jump.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.estimator.plants import Array, Plant
from benchmarks.estimator.records import Record, simulate
from benchmarks.fit_logs import KINDS, PLANTS, disturbance, fitted, write_log
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.native.kept_observer import kept_observer
from ndob_fmu.results.csv_files import read_csv
from ndob_fmu.results.recording import Recording
from ndob_fmu.results.run_files import RESULT

# Of each plant a parameter that acts as the disturbance does, and one that acts otherwise.
WRONG = {
    "joint": ("motor_damping", "joint_stiffness"),
    "cylinder": ("damping", "stiffness"),
    "motor": ("inertia", "flux"),
}
OFF = 0.15
_JUDGED = slice(100, -20)


def record_of(plant: Plant, kind: str, seed: int, H: float, rows: int, parameters: Mapping[str, float]) -> Record:
    """Return a record of a plant with some true parameters; steps are held over each step, the others are not."""
    times = np.asarray(H * np.arange(rows + 1), dtype=float)
    values = disturbance(plant, kind, seed, times)

    def d(t: float) -> float:
        return float(values[min(int(t / H + 1e-6), rows)] if kind == "steps" else np.interp(t, times, values))

    return simulate(plant, H, [seed], d, stop_time=rows * H, parameters=parameters)


def estimated(record: Record, values: Mapping[str, Any], native: Path) -> Recording:
    """Return what `estimate` says of a record; native: folder of native FMUs."""
    with TemporaryDirectory() as folder:
        log = write_log(record, Path(folder, "log.csv"))
        estimate_log(record.plant.model(), log, Path(folder, "out"), start_values=values, native=native)
        return read_csv(Path(folder, "out", RESULT))


def judged(record: Record, values: Mapping[str, Any], native: Path) -> Array:
    """Return errors and error bars (2,2,K) in D₀, of the online and of the smoothed estimate."""
    found, (name,) = estimated(record, values, native), record.plant.model().disturbances
    pairs = ((f"observer.{name}_hat", f"observer.{name}_std"), (f"smoother.{name}", f"smoother.{name}_std"))
    true, bound = record.d[:, 0], float(record.plant.bounds[0])
    return np.array([[(found[mean] - true)[_JUDGED], found[std][_JUDGED]] for mean, std in pairs]) / bound


def lines(name: str, kind: str, draws: int, rows: int, native: Path) -> list[str]:
    """Return a line for the right model, and for each wrong parameter."""
    plant, H, _ = PLANTS[name]
    found: dict[str, list[Array]] = {}
    for seed in range(draws):
        right = record_of(plant, kind, seed, H, rows, {})
        told = fitted(right, [], native).start_values
        found.setdefault("right", []).append(judged(right, told, native))
        for place, wrong in enumerate(WRONG[name]):
            value = plant.parameters[wrong]
            off = OFF * np.random.default_rng([seed, place, 9]).standard_normal()
            record = record_of(plant, kind, seed, H, rows, {wrong: value * (1.0 + off)})
            of_this = judged(record, {**told, f"{wrong}_std": OFF * value}, native)
            found.setdefault(f"{wrong} 15 % off", []).append(of_this)
    return [f"{name} {kind}, {what}: {_said(np.concatenate(all_draws, axis=2))}" for what, all_draws in found.items()]


def _said(found: Array) -> str:
    return "; ".join(
        f"{which} {np.mean(np.abs(error) <= 2.0 * std):.1%} within, median std {np.median(std):.2e}, RMS error "
        f"{np.sqrt(np.mean(error**2)):.2e}"
        for which, (error, std) in zip(("online", "smoothed"), found, strict=True)
    )


def main() -> None:
    """Print what the bands hold, for each plant and class."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--rows", type=int, default=3000)
    parser.add_argument("--plant", nargs="+", default=list(PLANTS), choices=list(PLANTS))
    parser.add_argument("--kind", nargs="+", default=list(KINDS), choices=KINDS)
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        for name in options.plant:
            kept_observer(PLANTS[name][0].model(), Path(folder), builds=True)
            for kind in options.kind:
                print(*lines(name, kind, options.draws, options.rows, Path(folder)), sep="\n", flush=True)


if __name__ == "__main__":
    main()
