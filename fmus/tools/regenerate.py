"""Write the files of the FMI cross-check for the FlexibleJoint FMUs.

    python fmus/tools/regenerate.py [FOLDER]

FOLDER, by default fmus/, gets FlexibleJointPlant/ and FlexibleJointObserver/ with two experiments each. In
`<Name>_in.csv` motor and load jump; `<Name>_paper_…` is the paper's example, the FMUs' default, without a jump.
`_in.csv` holds the inputs, `_ref.csv` the reference, `_ref.opt` how to run; fmus/tools/regression.py runs them.

No FMU is involved here. The plant's references come from SciPy and the equations written out below, so that they share
nothing with what they check. The observer's are runs of its core over samples of that plant: `_ref` by its default
method, `_paper_ref` by the paper's. They show that an estimate changed. Whether it is right is for the theory's tests.

Commit new files only together with the reason why the old ones no longer hold.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from math import sin
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from ndob_fmu import load_model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.results.csv_files import write_csv
from ndob_fmu.results.recording import Recording
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.step.paper_observer import paper_observer
from ndob_fmu.runtime.step.sampled_observer import sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings
from ndob_fmu.support.files import atomic_path

STOP_TIME = 20.0
STATES = ("link_angle", "link_rate", "motor_angle", "motor_rate")
OUTPUTS = ("motor_angle", "link_angle")
GENERATOR = 2.0
# The observer's step is ten times its default, because every one of its samples must stand in the file of inputs: fmpy
# holds a sample until the next row, and at π = 1e12 the stairs would appear in the estimate as impulses.
OBSERVER_STEP = 0.01
OUTPUT_INTERVAL = 0.05


@dataclass(frozen=True)
class Torques:
    """Torques of the motor and of the load, besides the generator's, from each of the times on (s, N·m)."""

    torques: Mapping[float, tuple[float, float]]

    def __call__(self, times: Array) -> Array:
        """Return both torques (len(times), 2)."""
        since = np.searchsorted(list(self.torques), times + 1e-9) - 1
        return np.array(list(self.torques.values()))[since]


PAPER = Torques({0.0: (0.0, 0.0)})
JUMPS = Torques(
    {
        0.0: (0.0, 0.0),
        4.0: (3.0, 0.0),
        6.0: (3.0, -1.5),
        8.0: (-2.0, -1.5),
        10.0: (-2.0, 1.0),
        12.0: (0.0, 1.0),
        16.0: (0.0, 0.0),
    }
)


def plant_solution(times: Array, experiment: Torques) -> Array:
    """Return x (len(times), 4) of the paper's example, from x = (1, 1, 1, 1), under the experiment's torques."""
    x, at_start = np.empty((len(times), 4)), np.ones(4)
    starts = list(experiment.torques)
    for (start, (motor, load)), end in zip(experiment.torques.items(), [*starts[1:], times[-1]], strict=True):

        def derivatives(t: float, x: Array, u: float = motor, d: float = GENERATOR + load) -> list[float]:
            spring = x[0] - x[2]
            return [x[1], -spring - 10.0 * sin(x[0]), x[3], spring - x[3] + u + d]

        inside = (times > start - 1e-9) & (times < end + 1e-9)
        wanted = np.clip(times[inside], start, end)
        solution = solve_ivp(
            derivatives, (start, end), at_start, method="DOP853", t_eval=wanted, rtol=1e-13, atol=1e-14
        )
        x[inside], at_start = solution.y.T, solution.y[:, -1]
    return x


def plant_inputs(experiment: Torques) -> Recording:
    """Return what the plant FMU takes in, at every step."""
    times = _grid(OUTPUT_INTERVAL)
    return Recording(times, ("motor_torque", "load_torque"), experiment(times))


def plant_reference(experiment: Torques) -> Recording:
    """Return what the plant FMU puts out; its disturbance at the end of a step is made with the input of that step."""
    times = _grid(OUTPUT_INTERVAL)
    x = plant_solution(times, experiment)
    names = ("motor_angle", "link_angle", "link_rate", "motor_rate", "load_torque_total")
    load = experiment(np.concatenate([times[:1], times[:-1]]))[:, 1]
    return Recording(times, names, np.column_stack([x[:, [2, 0, 1, 3]], GENERATOR + load]))


def observer_inputs(experiment: Torques) -> Recording:
    """Return what the observer FMU takes in, at every step."""
    times = _grid(OBSERVER_STEP)
    x = plant_solution(times, experiment)
    return Recording(times, ("motor_torque", *OUTPUTS), np.column_stack([experiment(times)[:, 0], x[:, [2, 0]]]))


def observers() -> tuple[Any, Any]:
    """Return the observers of methods 1 and 2 at the FMU's start values."""
    eq = compile_model(load_model("flexible_joint"))
    tuning, parameters = eq.observer, list(eq.parameters.values())
    paper = paper_observer(
        eq,
        parameters,
        PiSchedule(tuning.pi_start, tuning.pi_end, tuning.pi_ramp_time),
        alpha=tuning.alpha,
        noise_std=eq.noise_std,
        disturbance_bound=eq.disturbance_bound,
    )
    sampled = sampled_observer(eq, parameters, observer_settings(eq), eq.xhat0)
    return paper, sampled


def observer_reference(observer: Any, inputs: Recording) -> Recording:
    """Return what the observer FMU puts out for these inputs."""
    state = observer.init(observer.equations.xhat0)
    u, y = inputs.columns[:, :1], inputs.columns[:, 1:]
    estimates = [observer.estimate(state, y[0])]
    for k in range(len(inputs.time) - 1):
        state, estimate = observer.step(state, u[k], y[k], OBSERVER_STEP)
        estimates.append(estimate)
    names = (
        *(f"{state}_hat" for state in STATES),
        *(f"load_torque_{suffix}" for suffix in ("hat", "at_sample", "std", "lagged", "lagged_std")),
        *(f"{output}{suffix}" for suffix in ("_residual", "_residual_std") for output in OUTPUTS),
        *("valid", "consistency"),
    )
    rows = [
        [
            *(*e.x_hat, *e.d_hat, *e.d_at_sample, *e.d_std, *e.d_lagged, *e.d_lagged_std),
            *(*e.residual, *e.residual_std, e.valid, e.consistency),
        ]
        for e in estimates
    ]
    every = round(OUTPUT_INTERVAL / OBSERVER_STEP)
    return Recording(
        inputs.time[::every],
        names,
        np.array(rows, dtype=float)[::every],
        (*["Real"] * (len(names) - 2), "Boolean", "Real"),
    )


def _grid(step_size: float) -> Array:
    return np.asarray(np.arange(round(STOP_TIME / step_size) + 1) * step_size)


def _write_options(path: Path, step_size: float, tolerance: float) -> None:
    options = {
        "StartTime": 0.0,
        "StopTime": STOP_TIME,
        "StepSize": step_size,
        "RelTol": tolerance,
        "OutputIntervalHint": OUTPUT_INTERVAL,
    }
    with atomic_path(path) as temporary:
        temporary.write_text("".join(f"{name},{value}\n" for name, value in options.items()), "utf-8", newline="\n")


def main(folder: Path) -> None:
    """Write all files into the folder."""
    plant, observer = folder / "FlexibleJointPlant", folder / "FlexibleJointObserver"
    paper, sampled = observers()
    for ending, experiment, core in (("", JUMPS, sampled), ("_paper", PAPER, paper)):
        name = f"FlexibleJointPlant{ending}"
        if experiment is not PAPER:
            write_csv(plant / f"{name}_in.csv", plant_inputs(experiment))
        write_csv(plant / f"{name}_ref.csv", plant_reference(experiment))
        _write_options(plant / f"{name}_ref.opt", OUTPUT_INTERVAL, 1e-8)
        name = f"FlexibleJointObserver{ending}"
        inputs = observer_inputs(experiment)
        write_csv(observer / f"{name}_in.csv", inputs)
        write_csv(observer / f"{name}_ref.csv", observer_reference(core, inputs))
        _write_options(observer / f"{name}_ref.opt", OBSERVER_STEP, 1e-6)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1])
