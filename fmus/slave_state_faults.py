"""What is wrong with a state that came as bytes, whose checksum proves nothing: each value against its declaration.

Nothing here runs before `slave_state.from_bytes` has found the structure right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from math import isfinite, ulp
from typing import Any

import numpy as np

from fmus.slave_clock import TIME_TOLERANCE, Clock, experiment_fault
from fmus.slave_state import Snapshot
from fmus.slave_variables import is_declared, parameter_fault
from ndob_fmu.interface.variables import Variable
from ndob_fmu.runtime.base_errors import NdobError


def state_fault(snapshot: Snapshot, variables: Sequence[Variable]) -> NdobError | None:
    """Return what is wrong with a snapshot of a slave with these variables, but for its core."""
    return _values_fault(snapshot, variables) or _times_fault(snapshot) or _mode_fault(snapshot)


def same_form(template: Any, value: Any, *, grows: bool = False) -> bool:
    """Return whether a core's state is made of the types and has the shapes of another one of the same parameters.

    grows: whether the first dimension of a tuple or an array may be another one; a field of a state says so by its
    metadata.
    """
    if is_dataclass(template):
        return type(value) is type(template) and all(
            same_form(getattr(template, f.name), getattr(value, f.name), grows=f.metadata.get("grows", False))
            for f in fields(template)
        )
    if isinstance(template, np.ndarray):
        if not isinstance(value, np.ndarray) or (value.dtype, value.ndim) != (template.dtype, template.ndim):
            return False
        return bool(value.shape[grows:] == template.shape[grows:])
    if isinstance(template, tuple):
        if not isinstance(value, tuple):
            return False
        return grows or (len(value) == len(template) and all(map(same_form, template, value)))
    return type(value) is type(template.item() if isinstance(template, np.generic) else template)


def _values_fault(snapshot: Snapshot, variables: Sequence[Variable]) -> NdobError | None:
    values, parameters = snapshot.values, [v for v in variables if v.causality == "parameter"]
    started_with = snapshot.started_with
    if not isinstance(values, tuple) or len(values) != len(variables):
        return _fault("one value for each variable of this FMU")
    if started_with is not None and not (isinstance(started_with, tuple) and len(started_with) == len(parameters)):
        return _fault("one value for each parameter of this FMU")
    for variable, value in (*zip(variables, values, strict=True), *zip(parameters, started_with or (), strict=False)):
        if not is_declared(variable, value):
            return _fault(f"a {variable.type} for {variable.name}", f"one of type {type(value).__name__} or size")
    for variable, value in zip(parameters, started_with or (), strict=False):
        if fault := parameter_fault(variable, value):
            return fault
    return None


def _times_fault(s: Snapshot) -> NdobError | None:
    times = (s.start_time, s.time, s.step_size, *(() if s.stop_time is None else (s.stop_time,)))
    if not all(isinstance(time, float) for time in times) or not all(map(isfinite, times[:3])):
        return _fault("times that are finite numbers")
    # The last step may have been longer by a rounding error than the one that it was taken for.
    longest = (1.0 + TIME_TOLERANCE) * s.step_size
    fault = experiment_fault(s.start_time, s.stop_time) or Clock(stop=s.stop_time).stop_fault(s.time, longest)
    if fault:
        return fault
    passed = s.time - s.start_time
    longest = passed / (1.0 - TIME_TOLERANCE) + 8.0 * ulp(max(abs(s.time), abs(s.start_time)))
    if passed < 0.0 or not 0.0 <= s.step_size <= longest:
        return _fault("a step within the time since the start")
    return None


def _mode_fault(s: Snapshot) -> NdobError | None:
    made = s.started_with is not None
    if not isinstance(s.initializing, bool) or not isinstance(s.stale, bool) or (s.core is not None and not made):
        return _fault("a mode that an instance can be in")
    begun = s.time > s.start_time or s.step_size > 0.0
    possible = not begun and (made or s.stale) if s.initializing else not s.stale and (made or not begun)
    return None if possible else _fault("a mode that an instance can be in")


def _fault(expected: str, received: str = "others") -> NdobError:
    return NdobError.report("FMU state", expected=expected, received=received)
