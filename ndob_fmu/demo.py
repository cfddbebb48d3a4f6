"""The demo: the paper's example as a co-simulation of its two FMUs, with figures and a summary."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.cosim import simulate
from ndob_fmu.cosim.run_folder import summary_of, write_system_picture
from ndob_fmu.errors import NdobError
from ndob_fmu.results import plots
from ndob_fmu.results.recording import Recording
from ndob_fmu.results.run_files import write_run
from ndob_fmu.support.files import atomic_folder

STATES = ("link_angle", "link_rate", "motor_angle", "motor_rate")
DISTURBANCE = "load_torque"
_SAMPLED_DATA = 2
_START_UP_TIME = 2.0


@dataclass(frozen=True)
class ExampleResults:
    """The results of the example, arrays (rows,): time in s, d and d̂ in N·m, and ‖x − x̂‖."""

    time: NDArray[np.float64]
    disturbance: NDArray[np.float64]
    estimate: NDArray[np.float64]
    state_error: NDArray[np.float64]

    @property
    def error(self) -> NDArray[np.float64]:
        """|d̂ − d|, (rows,)."""
        return np.abs(self.estimate - self.disturbance)

    @property
    def settling_time(self) -> float | None:
        """Time in s from which |d̂ − d| stays within 2 % of |d|; None if it never does."""
        outside = np.flatnonzero(self.error > 0.02 * np.abs(self.disturbance))
        if len(outside) == 0:
            return float(self.time[0])
        return float(self.time[outside[-1] + 1]) if outside[-1] + 1 < len(self.time) else None

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers for summary.json."""
        late = self.time >= 12.0
        return {
            "settling_time_2_percent": self.settling_time,
            "final_estimate": float(self.estimate[-1]),
            "final_disturbance_error": float(self.error[-1]),
            "max_disturbance_error_from_12_s": float(self.error[late].max()) if late.any() else None,
            "peak_estimate": float(np.abs(self.estimate).max()),
            "final_state_error": float(self.state_error[-1]),
            "max_state_error": float(self.state_error.max()),
        }


def example_results(recording: Recording) -> ExampleResults:
    """Compare the estimates with the true values, both for the end of each step."""
    errors = [recording[f"plant.{state}"] - recording[f"observer.{state}_hat"] for state in STATES]
    return ExampleResults(
        time=recording.time,
        disturbance=recording[f"plant.{DISTURBANCE}_total"],
        estimate=recording[f"observer.{DISTURBANCE}_hat"],
        state_error=np.linalg.norm(errors, axis=0),
    )


def run_demo(
    system: Path, results: Path, *, native: Callable[[], Path] | None = None, **overrides: Any
) -> dict[str, Any]:
    """Run the example's system package, write CSV, summary and figures into `results`, and return the summary.

    native: returns the same system with native FMUs, for the comparison in the summary; it may raise NdobError
    overrides: for `simulate`

    Raises what `simulate` raises.
    """
    began = time.perf_counter()
    recording, seconds = _timed(system, overrides)
    wall_time = time.perf_counter() - began
    shorter = min(_START_UP_TIME, float(recording.time[-1]))

    def start_up(**changed: float) -> ExampleResults:
        starts = {**(overrides.get("start_values") or {}), **{f"observer.{name}": v for name, v in changed.items()}}
        return example_results(simulate(system, **{**overrides, "stop_time": shorter, "start_values": starts}))

    shown, peaking = example_results(recording), start_up(pi_ramp_time=0.0)
    everyday = start_up(method=_SAMPLED_DATA)
    summary = {
        **summary_of(system, recording, overrides),
        "method": "paper",
        **shown.to_dict(),
        "peak_estimate_without_schedule": float(np.abs(peaking.estimate).max()),
        "sampled_data": {
            "settling_time_2_percent": everyday.settling_time,
            "peak_estimate": float(np.abs(everyday.estimate).max()),
            "final_disturbance_error": float(everyday.error[-1]),
        },
        "wall_time": wall_time,
    }
    if native is not None:
        summary["native"] = _compared(system, native, overrides, recording, seconds)
    with atomic_folder(results) as new:
        write_run(new, recording, summary)
        _draw_figures(new, shown, peaking, everyday)
        write_system_picture(new, system)
    return summary


def _timed(system: Path, settings: Mapping[str, Any]) -> tuple[Recording, float]:
    """Simulate, and return the seconds of processor time that it took in this thread; others may compile meanwhile."""
    began = time.thread_time()
    recording = simulate(system, **settings)
    return recording, time.thread_time() - began


def _compared(
    system: Path, native: Callable[[], Path], settings: Mapping[str, Any], recording: Recording, seconds: float
) -> dict[str, Any]:
    """Compare the system with the same one of native FMUs, with both methods: seconds, and the largest difference.

    recording, seconds: of the system as the settings have it, with the paper's method
    """
    try:
        other = native()
    except NdobError as error:
        return {"not_built": str(error)}
    sampled = {**settings, "start_values": {**(settings.get("start_values") or {}), "observer.method": _SAMPLED_DATA}}
    both = {
        "paper": ((recording, seconds), _timed(other, settings)),
        "sampled_data": (_timed(system, sampled), _timed(other, sampled)),
    }
    return {
        method: {"python_seconds": python[1], "native_seconds": own[1], "difference": _difference(python[0], own[0])}
        for method, (python, own) in both.items()
    }


def _difference(one: Recording, other: Recording) -> float:
    """Return the largest difference of a signal of the plant or an estimate, over the signal's largest value."""
    shown = [name for name in one.names if name.startswith("plant.") or name.endswith("_hat")]
    return max(float(np.abs(other[name] - one[name]).max() / (np.abs(one[name]).max() or 1.0)) for name in shown)


def _draw_figures(results: Path, shown: ExampleResults, peaking: ExampleResults, everyday: ExampleResults) -> None:
    label = "load torque [N·m]"
    plots.plot_disturbance(
        results / "fig1_disturbance.png",
        shown.time,
        shown.disturbance,
        shown.estimate,
        label=label,
        error_label="|estimate − true| [N·m]",
        settled_at=shown.settling_time,
    )
    plots.plot_state_error(results / "fig2_state_error.png", shown.time, shown.state_error)
    plots.plot_peaking(
        results / "fig3_peaking.png",
        (shown.time, shown.estimate),
        (peaking.time, peaking.estimate),
        label=f"estimated {label}",
    )
    plots.plot_start_up(
        results / "fig4_start_up.png",
        {
            "paper, final π from the start": (peaking.time, peaking.error),
            "paper, π raised along the schedule": (shown.time, shown.error),
            "sampled-data design (method 2)": (everyday.time, everyday.error),
        },
        label="error of d̂ [N·m]",
    )
