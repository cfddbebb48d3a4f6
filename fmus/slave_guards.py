"""What is wrong with what a host or a user has given: nothing raises, each fault is an error to be logged."""

from __future__ import annotations

from math import inf, isfinite, ulp
from typing import Any

from ndob_fmu.interface.variables import Variable
from ndob_fmu.runtime.base_errors import NdobError

# What computing with impossible numbers raises; LinAlgError is a ValueError.
_IMPOSSIBLE = (ArithmeticError, ValueError)
_LONGEST_MESSAGE = 300
# A step begins where the last one ended, within this part of a step: hosts add up steps, or round them to nanoseconds.
TIME_TOLERANCE = 1e-3
# What stands for each type of FMI, and the range of its Integer.
PYTHON_TYPES = {"Real": float, "Boolean": bool, "Integer": int, "Enumeration": int, "String": str}
_INTEGERS = range(-(2**31), 2**31)


def failure(where: str, error: Exception) -> NdobError:
    """Return what a computation raised as a message for users; `where` says in what."""
    if isinstance(error, NdobError):
        return error
    received = f"{error} ({type(error).__name__})"
    if isinstance(error, _IMPOSSIBLE):
        return NdobError.report(where, expected="numbers that can be computed with", received=received)
    return NdobError.report(where, expected="a result", received=received, likely="a defect of this FMU; report it")


def printable(text: str) -> str:
    """Return the text as any host's logger can take it: one line, UTF-8, at most 300 characters, as a printf format."""
    line = " ".join(text.encode("utf-8", "backslashreplace").decode().split())
    if len(line) > _LONGEST_MESSAGE:
        half = (_LONGEST_MESSAGE - 1) // 2
        line = f"{line[:half]}…{line[-half:]}"
    return "".join(c if c.isprintable() else "?" for c in line).replace("%", "%%")


def experiment_fault(start_time: float, stop_time: float | None) -> NdobError | None:
    """Return what is wrong with the times of an experiment (s)."""
    if isfinite(start_time) and (stop_time is None or stop_time >= start_time):
        return None
    stop = "" if stop_time is None else f" and {stop_time:g} s"
    return NdobError.report(
        "experiment", expected="a finite start time and no stop time before it", received=f"{start_time:g} s{stop}"
    )


def step_fault(current_time: float, step_size: float, follows: float, last_step: float) -> NdobError | None:
    """Return what is wrong with a step that should start at the time `follows` (s), after one of `last_step` s."""
    if not 0.0 < step_size < inf:
        return NdobError.report("communication step", expected="a finite time > 0 s", received=f"{step_size!r} s")
    if not abs(current_time - follows) <= _tolerance(max(step_size, last_step), follows):
        expected = f"{follows!r} s, where the last one ended"
        return NdobError.report("time of the step", expected=expected, received=f"{current_time!r} s")
    if current_time + step_size > current_time:
        return None
    received = f"{step_size!r} s, which is lost in rounding at {current_time!r} s"
    return NdobError.report("communication step", expected="one that moves the time", received=received)


def stop_fault(end: float, step_size: float, stop_time: float | None) -> NdobError | None:
    """Return what is wrong with a step that goes on to `end`, if that is after `stop_time` (s)."""
    if stop_time is None or end <= stop_time + _tolerance(step_size, stop_time):
        return None
    return NdobError.report("end of the step", expected=f"at most the stop time {stop_time:g} s", received=f"{end:g} s")


def added_rounding(time: float, start_time: float, step_size: float) -> float:
    """Return by how much (s) a host's time may be wrong that has added steps of `step_size` up since `start_time` (s).

    That is a rounding error for each step, and at most a thousandth of a step; 0 before the first step, of size 0.
    """
    if step_size == 0.0:
        return 0.0
    steps = 1.0 + (time - start_time) / step_size
    return min(steps * ulp(max(abs(time), abs(start_time))), TIME_TOLERANCE * step_size)


def _tolerance(step_size: float, time: float) -> float:
    return max(TIME_TOLERANCE * step_size, 4.0 * ulp(time))


def is_declared(variable: Variable, value: Any) -> bool:
    """Return whether a value is of the variable's declared type: exactly what a host can set or get."""
    if type(value) is not PYTHON_TYPES[variable.type]:
        return False
    if isinstance(value, str):
        return "\0" not in value and value.encode("utf-8", "replace").decode() == value
    return isinstance(value, float) or value in _INTEGERS


def parameter_fault(variable: Variable, value: Any) -> NdobError | None:
    """Return what is wrong with the value of a parameter."""
    expected = _acceptable(variable, value)
    return NdobError.report(variable.name, expected=expected, received=repr(value)) if expected else None


def _acceptable(variable: Variable, value: Any) -> str:
    """Return what a parameter's value should have been, or nothing if it is that."""
    if variable.type in ("Boolean", "String"):
        return ""
    if variable.items is not None:
        allowed = ", ".join(f"{number} ({item})" for item, number in variable.items.items())
        return "" if value in variable.items.values() else f"one of {allowed}"
    too_small = (variable.minimum is not None and value < variable.minimum) or (variable.positive and value <= 0.0)
    too_large = variable.maximum is not None and value > variable.maximum
    if isfinite(value) and not too_small and not too_large:
        return ""
    least = "" if variable.minimum is None else " > 0" if variable.positive else f" of at least {variable.minimum:g}"
    most = "" if variable.maximum is None else f" and at most {variable.maximum:g}"
    return f"a finite number{least}{most}"
