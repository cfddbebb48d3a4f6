"""The times of an instance, and what is wrong with those that a host gives. All times are in seconds."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, ulp

from ndob_fmu.runtime.base_errors import NdobError

# A step begins where the last one ended, within this part of a step: hosts add up steps, or round them to nanoseconds.
TIME_TOLERANCE = 1e-3


@dataclass
class Clock:
    """Where an instance is in its experiment.

    start: the time at which the experiment starts
    stop: the time at which it ends; None if the host has not said
    now: the end of the last step
    step_size: the length of the last step; 0 before the first one
    """

    start: float = 0.0
    stop: float | None = None
    now: float = 0.0
    step_size: float = 0.0

    def set_up(self, start: float, stop: float | None) -> NdobError | None:
        """Begin an experiment, or return what is wrong with its times."""
        fault = experiment_fault(start, stop)
        if not fault:
            self.start = self.now = start
            self.stop, self.step_size = stop, 0.0
        return fault

    def continues(self, time: float, step_size: float) -> bool:
        """Whether a step follows the last one exactly and is as long, as nearly all steps do."""
        return time == self.now and 0.0 < step_size == self.step_size and time < time + step_size < inf

    def step_fault(self, time: float, step_size: float) -> NdobError | None:
        """Return what is wrong with a step that begins at `time`."""
        if not 0.0 < step_size < inf:
            return NdobError.report("communication step", expected="a finite time > 0 s", received=f"{step_size!r} s")
        if not abs(time - self.now) <= _tolerance(max(step_size, self.step_size), self.now):
            expected = f"{self.now!r} s, where the last one ended"
            return NdobError.report("time of the step", expected=expected, received=f"{time!r} s")
        if time + step_size > time:
            return None
        received = f"{step_size!r} s, which is lost in rounding at {time!r} s"
        return NdobError.report("communication step", expected="one that moves the time", received=received)

    def end_fault(self, end: float) -> NdobError | None:
        """Return what is wrong with a step that goes on to `end`, if the last one has gone as far."""
        if self.now < end < inf:
            return None
        expected = f"a finite time after {self.now!r} s, where the last one ended"
        return NdobError.report("end of the step", expected=expected, received=f"{end!r} s")

    def stop_fault(self, end: float, step_size: float) -> NdobError | None:
        """Return what is wrong with a step that goes on to `end`, if that is after the stop time."""
        stop = self.stop
        if stop is None or end <= stop + _tolerance(step_size, stop):
            return None
        return NdobError.report("end of the step", expected=f"at most the stop time {stop:g} s", received=f"{end:g} s")

    def added_rounding(self, time: float) -> float:
        """Return by how much the time of a host may be wrong that has added its steps up since the start.

        That is a rounding error for each step, and at most a thousandth of a step; 0 before the first step.
        """
        if self.step_size == 0.0:
            return 0.0
        steps = 1.0 + (time - self.start) / self.step_size
        return min(steps * ulp(max(abs(time), abs(self.start))), TIME_TOLERANCE * self.step_size)

    def settled(self, step_size: float, end: float, rounding: float) -> float:
        """Return the last step's size for one that differs from it by rounding only, else the size itself.

        A step that is the difference of two rounded times varies in its last bits, and a design is made for each size.
        """
        last = self.step_size
        return last if last and abs(step_size - last) <= max(2.0 * ulp(end), rounding) else step_size


def experiment_fault(start: float, stop: float | None) -> NdobError | None:
    """Return what is wrong with the times of an experiment."""
    if isfinite(start) and (stop is None or stop >= start):
        return None
    given = "" if stop is None else f" and {stop:g} s"
    return NdobError.report(
        "experiment", expected="a finite start time and no stop time before it", received=f"{start:g} s{given}"
    )


def _tolerance(step_size: float, time: float) -> float:
    return max(TIME_TOLERANCE * step_size, 4.0 * ulp(time))
