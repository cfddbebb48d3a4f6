"""Write the reference files of the FlexibleJoint FMUs' default experiment.

    python fmus/regenerate.py [FOLDER]

FOLDER, by default the one this file lies in, gets FlexibleJointPlant/ and FlexibleJointObserver/ with the files of the
FMI cross-check: `_in.csv` the inputs, `_ref.csv` the reference, `_ref.opt` how to run. No FMU is involved. The plant's
reference comes from SciPy and from the equations written out below, so that it shares nothing with what it checks. The
observer's are runs of its core over samples of that plant, `_ref` by its default method, `_paper_ref` by the paper's.
They tell that an estimate changed, not that it is right; that is for the tests of the theory.

Commit new files only together with the reason why the old ones no longer hold.
"""

from __future__ import annotations

import sys
from math import sin
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ndob_fmu import load_model
from ndob_fmu.results import Recording, atomic_path, write_csv
from ndob_fmu.runtime.paper_observer import paper_observer
from ndob_fmu.runtime.sampled_observer import sampled_observer
from ndob_fmu.runtime.schedule import PiSchedule

Array = NDArray[np.float64]

STOP_TIME = 20.0
STATES = ("link_angle", "link_rate", "motor_angle", "motor_rate")
OUTPUTS = ("motor_angle", "link_angle")
LOAD_TORQUE = 2.0
# The observer's step is ten times its default, because every one of its samples must stand in the file of inputs:
# fmpy puts a straight line between two rows, and at π = 1e12 the corners would appear in the estimate as impulses.
OBSERVER_STEP = 0.01
OUTPUT_INTERVAL = 0.05


def plant_solution(times: Array) -> Array:
    """Return x (len(times), 4) of the paper's example from x = (1, 1, 1, 1), u = 0, d = 2."""

    def derivatives(t: float, x: Array) -> list[float]:
        spring = x[0] - x[2]
        return [x[1], -spring - 10.0 * sin(x[0]), x[3], spring - x[3] + LOAD_TORQUE]

    span = (times[0], times[-1])
    solution = solve_ivp(derivatives, span, [1.0] * 4, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-14)
    return np.asarray(solution.y.T)


def plant_reference() -> Recording:
    """Return what the plant FMU puts out."""
    times = _grid(OUTPUT_INTERVAL)
    x = plant_solution(times)
    names = ("motor_angle", "link_angle", "link_rate", "motor_rate", "load_torque_total")
    return Recording(times, names, np.column_stack([x[:, [2, 0, 1, 3]], np.full(len(times), LOAD_TORQUE)]))


def observer_inputs() -> Recording:
    """Return what the observer FMU takes in, at every step."""
    times = _grid(OBSERVER_STEP)
    x = plant_solution(times)
    return Recording(times, ("motor_torque", *OUTPUTS), np.column_stack([np.zeros(len(times)), x[:, [2, 0]]]))


def observers() -> dict[str, Any]:
    """Return the observers of both methods at the FMU's start values, by the name that their reference has."""
    eq = load_model("flexible_joint").equations
    tuning, parameters = eq.observer, list(eq.parameters.values())
    paper = paper_observer(
        eq, parameters, PiSchedule(tuning.pi_start, tuning.pi_end, tuning.pi_ramp_time), alpha=tuning.alpha
    )
    sampled = sampled_observer(
        eq,
        parameters,
        order=tuning.disturbance_order,
        noise_std=tuning.noise_std,
        disturbance_bound=eq.disturbance_bound,
        disturbance_rate=eq.disturbance_rate,
        x_hat=eq.xhat0,
        x_std=eq.xhat0_std,
        alpha=tuning.alpha,
        pi=tuning.pi_end,
    )
    return {"FlexibleJointObserver_ref.csv": sampled, "FlexibleJointObserver_paper_ref.csv": paper}


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
        *("load_torque_hat", "load_torque_at_sample"),
        *(f"{output}_residual" for output in OUTPUTS),
        "valid",
    )
    rows = [[*e.x_hat, *e.d_hat, *e.d_at_sample, *e.residual, e.valid] for e in estimates]
    every = round(OUTPUT_INTERVAL / OBSERVER_STEP)
    return Recording(
        inputs.time[::every], names, np.array(rows, dtype=float)[::every], (*["Real"] * (len(names) - 1), "Boolean")
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
    write_csv(plant / "FlexibleJointPlant_ref.csv", plant_reference())
    _write_options(plant / "FlexibleJointPlant_ref.opt", OUTPUT_INTERVAL, 1e-8)
    inputs = observer_inputs()
    write_csv(observer / "FlexibleJointObserver_in.csv", inputs)
    for name, core in observers().items():
        write_csv(observer / name, observer_reference(core, inputs))
    _write_options(observer / "FlexibleJointObserver_ref.opt", OBSERVER_STEP, 1e-6)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
