"""Components made of a few lambdas, which record every call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ndob_fmu.cosim import Variable

Lambda = Callable[..., Any]


class Mock:
    """output(x, u) → values; step(x, u, t, h) → x; on(call, time) runs at the start of every call and may raise.
    ends(t, h) → None or Ended.

    u is a dict of the inputs by name; outputs are those of `outputs` in that order.
    """

    def __init__(
        self,
        inputs: Sequence[str | Variable] = (),
        outputs: Sequence[str | Variable] = (),
        *,
        output: Lambda = lambda x, u: x,
        step: Lambda = lambda x, u, t, h: x,
        x: Any = (),
        parameters: Sequence[Variable] = (),
        on: Lambda = lambda call, time: None,
        ends: Lambda = lambda t, h: None,
    ) -> None:
        named = [v if isinstance(v, Variable) else Variable(v, "input") for v in inputs]
        named += [v if isinstance(v, Variable) else Variable(v, "output", settable=False) for v in outputs]
        self.variables = (*named, *parameters)
        self.output, self.advance, self.x0, self.on = output, step, x, on
        self.ends = ends
        self.calls: list[str] = []
        self.times: list[tuple[float, float]] = []
        self.received: list[dict[str, float]] = []

    def _note(self, call: str, time: float = np.nan) -> None:
        self.calls.append(call)
        self.on(call, time)

    def setup(self, start_time, stop_time, start_values, inputs, tolerance=None):
        self.inputs, self.x = inputs, self.x0
        self.u = {v.name: 0.0 for v in self.variables if v.causality != "output"} | dict(start_values)
        self._note("setup", start_time)

    def set_inputs(self, values):
        self.u |= dict(zip(self.inputs, values.tolist(), strict=True))
        self._note("set_inputs")

    def get_outputs(self, values):
        self._note("get_outputs")
        values[:] = self.output(self.x, self.u)

    def initialize(self):
        self._note("initialize")

    def step(self, time, step_size):
        self._note("step", time)
        self.times.append((time, step_size))
        self.received.append(dict(self.u))
        self.x = self.advance(self.x, self.u, time, step_size)
        return self.ends(time, step_size)

    def close(self):
        self._note("close")


def integrator(x: float = 0.0, **more: Any) -> Mock:
    """y' = u, exact for a held input."""
    return Mock(["u"], ["y"], output=lambda x, u: [x], step=lambda x, u, t, h: x + h * u["u"], x=x, **more)


def constant(value: float, **more: Any) -> Mock:
    return Mock([], ["y"], output=lambda x, u: [value], **more)


def ramp(**more: Any) -> Mock:
    """y = t."""
    return Mock([], ["y"], output=lambda x, u: [x], step=lambda x, u, t, h: t + h, x=0.0, **more)


def gain(k: float = 1.0, **more: Any) -> Mock:
    """y = k u for u during the step: outputs change in steps, and during initialization."""
    return Mock(["u"], ["y"], output=lambda x, u: [k * u["u"]], **more)
