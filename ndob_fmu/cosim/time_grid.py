"""The time grid of a run. Time is counted in whole steps, so that rounding errors do not add up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ndob_fmu.errors import NdobError, UsageError

_RELATIVE_TOLERANCE = 1e-9  # far above the rounding of stop/step in double precision, far below half a step
_SAME_POINT = 1e-6  # of a step: a component reports a time that it has added up itself


@dataclass(frozen=True)
class TimeGrid:
    """Communication points t_k = start_time + k·step_size, k = 0 … steps; every ``stride``-th one is recorded."""

    start_time: float
    step_size: float
    steps: int
    stride: int

    @classmethod
    def over(cls, start_time: float, stop_time: float, step_size: float, output_interval: float | None) -> TimeGrid:
        """Return the grid from start to stop time (s); no output interval means that every point is recorded.

        When the stop time is not a multiple of the output interval, the last row is the last multiple before it.
        Raises UsageError for times that are not finite, a step size or output interval that is not positive, a stop
        time that is not after the start time, or a ratio that is not a whole number within 1e-9.
        """
        times = {"start time": start_time, "stop time": stop_time, "step size": step_size}
        if output_interval is not None:
            times["output interval"] = output_interval
        for name, value in times.items():
            if not math.isfinite(value):
                raise UsageError.report(name, expected="a finite number of seconds", received=repr(value))
            if name in ("step size", "output interval") and value <= 0:
                raise UsageError.report(name, expected="a positive number of seconds", received=repr(value))
        span = stop_time - start_time
        if span <= 0:
            received = f"{stop_time!r} s"
            raise UsageError.report(
                "stop time", expected=f"a time after the start, {start_time!r} s", received=received
            )
        steps = _whole("stop time minus start time", span, step_size)
        stride = 1 if output_interval is None else _whole("output interval", output_interval, step_size)
        if stride > steps:
            raise UsageError.report(
                "output interval", expected=f"at most {span!r} s", received=f"{output_interval!r} s"
            )
        return cls(start_time, step_size, steps, stride)

    def reached(self, time: float) -> int:
        """Return the last k with t_k ≤ ``time`` (s); a time that is just short of t_k by rounding counts as t_k."""
        return math.floor((time - self.start_time) / self.step_size + _SAME_POINT)

    def is_point(self, time: float) -> bool:
        """Return whether ``time`` (s) is a communication point, up to rounding."""
        steps = (time - self.start_time) / self.step_size
        return abs(steps - round(steps)) <= _SAME_POINT

    def until(self, steps: int) -> TimeGrid:
        """Return the grid that ends after ``steps`` steps, if it does not end before."""
        return replace(self, steps=min(steps, self.steps))

    def time(self, k: int) -> float:
        """Return t_k in seconds."""
        return self.start_time + k * self.step_size


def _whole(name: str, duration: float, step_size: float) -> int:
    ratio = duration / step_size
    if math.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) <= _RELATIVE_TOLERANCE * ratio:
        return round(ratio)
    raise _not_whole(name, duration, step_size, ratio)


def _not_whole(name: str, duration: float, step_size: float, ratio: float) -> NdobError:
    nearest = max(1, round(ratio)) * step_size if math.isfinite(ratio) else step_size
    return UsageError.report(
        name,
        expected=f"a whole number of steps of {step_size!r} s",
        received=f"{duration!r} s = {ratio:.9g} steps",
        likely=f"the nearest that fits is {nearest:.12g} s",
    )
