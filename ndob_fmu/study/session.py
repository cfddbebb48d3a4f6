"""One system that is opened once and run many times with different values."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from ndob_fmu.cosim import FmuComponent, System, open_system, simulate
from ndob_fmu.errors import NdobError
from ndob_fmu.results.recording import Recording
from ndob_fmu.study.columns import ENDED_AT, FAILED, REASON, RUN, TIME, WALL_TIME, over_time
from ndob_fmu.study.study import STEP_SIZE, Study

_MOST_OF_A_REASON = 500


class Session:
    """FMUs are unpacked and instantiated at the first run, and reset from run to run, until ``close``.

    files: where the study's files lie on this machine, by the names that the study gives them. A session belongs to
    one thread at a time.
    """

    def __init__(self, study: Study, files: dict[str, Path]) -> None:
        self._study = study
        self._release = ExitStack()
        self._path = files[study.system]
        settings = study.simulation
        self._system, experiment = self._release.enter_context(open_system(self._path, settings.step_size))
        self._ratios: dict[float, Mapping[str, int]] = {}
        for component in self._system.components.values():
            if isinstance(component, FmuComponent):
                self._release.enter_context(component.kept())
        self._settings: dict[str, Any] = {
            "start_time": experiment.start_time if settings.start_time is None else settings.start_time,
            "stop_time": experiment.stop_time if settings.stop_time is None else settings.stop_time,
            STEP_SIZE: experiment.step_size if settings.step_size is None else settings.step_size,
            "output_interval": settings.output_interval,
            "input_file": None if settings.input_file is None else files[settings.input_file],
            "scheme": settings.scheme,
            "order": settings.order,
            "tolerance": settings.tolerance,
            "strict": settings.strict,
            "progress": False,
        }

    def run(self, run: int) -> dict[str, Any]:
        """Return the row of a run: its values and measures, or the reason why it failed."""
        point = self._study.points[run]
        began = time.perf_counter()
        row: dict[str, Any] = {RUN: run, **point, FAILED: False}
        try:
            row |= self._kept(self._simulate(dict(point)))
        except NdobError as error:
            row |= {FAILED: True, REASON: str(error)[:_MOST_OF_A_REASON]}
        except Exception as error:  # any error of a run is the result of this run only
            row |= {FAILED: True, REASON: f"{type(error).__name__}: {error}"[:_MOST_OF_A_REASON]}
        return row | {WALL_TIME: time.perf_counter() - began}

    def _kept(self, recording: Recording) -> dict[str, Any]:
        kept: dict[str, Any] = {name: measure(recording) for name, measure in self._study.measures.items()}
        if recording.ended_early:
            kept[ENDED_AT] = float(recording.time[-1])
        if self._study.record:
            kept[TIME] = recording.time.tolist()
            kept |= {over_time(name): recording[name].tolist() for name in self._study.record}
        return kept

    def _simulate(self, point: dict[str, Any]) -> Recording:
        system, settings = self._system, self._settings
        if STEP_SIZE in point:
            step_size = float(point.pop(STEP_SIZE))
            system, settings = self.system_for(step_size), {**settings, STEP_SIZE: step_size}
        return simulate(system, start_values={**self._study.fixed, **point}, **settings)

    def system_for(self, step_size: float) -> System:
        """Return the system for a communication step (s), of which its components' own steps are multiples."""
        if step_size not in self._ratios:
            with open_system(self._path, step_size) as (opened, _):
                self._ratios[step_size] = opened.step_ratios
        return replace(self._system, step_ratios=self._ratios[step_size])

    def close(self) -> None:
        """Free the FMUs and delete what was unpacked."""
        self._release.close()
