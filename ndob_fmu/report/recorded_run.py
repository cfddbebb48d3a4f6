"""A run as its folder holds it: signals, inputs from a file, and the coupling of the components."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ndob_fmu.report.content import pretty
from ndob_fmu.report.signals import estimates
from ndob_fmu.results.recording import Recording
from ndob_fmu.results.run_files import read_run
from ndob_fmu.results.shown_time import ShownTime, shown_time
from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True)
class RecordedRun:
    """A run.

    recording: the outputs.
    inputs: the inputs from an input file, by port.
    summary: the entries of summary.json.
    """

    recording: Recording
    inputs: Mapping[str, Array] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)

    @property
    def time(self) -> Array:
        """Time of the rows in s (rows,), as it is shown."""
        return self.shown_time.of(self.recording.time)

    @property
    def shown_time(self) -> ShownTime:
        """How people read the times of the rows."""
        own = self.recording.time
        return shown_time(float(own[0]), float(np.median(np.diff(own)))) if len(own) > 1 else ShownTime()

    @property
    def units(self) -> Mapping[str, str]:
        """Units by signal and parameter."""
        return {name: pretty(unit) for name, unit in self.summary.get("units", {}).items()}

    def get(self, name: str) -> Array | None:
        """Return a recorded output (rows,), None if there is none of that name."""
        return self.recording[name] if name in self.recording.names else None

    def observers(self) -> dict[str, list[str]]:
        """Return the disturbances that each observer estimates: those with an estimate and an error bar."""
        found: dict[str, list[str]] = {}
        for name in self.recording.names:
            component, _, variable = name.partition(".")
            of = variable.removesuffix("_hat")
            if of != variable and f"{component}.{of}_std" in self.recording.names:
                found.setdefault(component, []).append(of)
        return found

    def truth(self, estimate: str) -> str | None:
        """Return the name of the signal that an estimate is of."""
        return next((truth for truth, found in estimates(self.recording.names) if found == estimate), None)

    def input(self, port: str) -> Array | None:
        """Return what an input had at each row, (rows,): from the file, or from the output that drives it.

        Where summary.json does not tell what drives it, the only other component's output of that name does.
        """
        if port in self.inputs:
            return self.inputs[port]
        connections = self.summary.get("connections", {})
        if port in connections:
            source, factor, offset = connections[port]
            signal = self.get(source)
            return None if signal is None else factor * signal + offset
        component, _, variable = port.partition(".")
        others = [
            n for n in self.recording.names if n.partition(".")[2] == variable and not n.startswith(f"{component}.")
        ]
        return self.get(others[0]) if len(others) == 1 and not connections else None

    def driven(self, component: str) -> list[str]:
        """Return the inputs of a component that are known over time."""
        ports = dict.fromkeys([*self.inputs, *self.summary.get("connections", {})])
        return [port for port in ports if port.startswith(f"{component}.")]

    def step_rows(self, component: str) -> int | None:
        """Return how many rows a step of the component takes; None where there are steps without a row."""
        if "output_interval" in self.summary:
            return None
        ratio: int = self.summary.get("step_ratios", {}).get(component, 1)
        return ratio

    def sees_end_of_step(self, port: str) -> bool:
        """Whether an input has the value at the end of the step, from a component that has stepped before."""
        order = self.summary.get("order", [])
        source = self.summary.get("connections", {}).get(port, [""])[0].partition(".")[0]
        component = port.partition(".")[0]
        return source in order and component in order and order.index(source) < order.index(component)


def read_recorded_run(folder: Path) -> RecordedRun:
    """Return the run in ``folder``. Raises UsageError if a file cannot be read, or was changed since it was written."""
    recording, summary, inputs = read_run(folder)
    return RecordedRun(recording, {} if inputs is None else {name: inputs[name] for name in inputs.names}, summary)
