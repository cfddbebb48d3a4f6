"""`<Name>Observer`: the disturbance observer, one step of the core per doStep."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from fmus.slave_base import Slave
from ndob_fmu.runtime.interface import Variable, observer_variables
from ndob_fmu.runtime.paper_observer import Estimate, ObserverState, paper_observer
from ndob_fmu.runtime.schedule import PiSchedule


class ObserverSlave(Slave):
    """Designs the observer from the parameters when initialization ends, then steps it."""

    def declare(self) -> tuple[Variable, ...]:
        """Return the observer's variables."""
        return observer_variables(self.equations)

    def start(self, start_time: float) -> None:
        """Design the gains and start from the given estimate of the state."""
        eq = self.equations
        schedule = PiSchedule(*self.values(["pi_start", "pi_end", "pi_ramp_time"]))
        self.observer = paper_observer(eq, self.values(eq.parameters), schedule, alpha=self.value("alpha"))
        self.state: ObserverState = self.observer.init(self.values(f"{name}_hat_start" for name in eq.states))

    def show(self) -> Iterable[Any]:
        """Return the estimate that the first sample alone gives."""
        return _outputs(self.observer.estimate(self.state, self.values(self.equations.outputs)))

    def advance(self, t: float, step_size: float) -> Iterable[Any]:
        """Take in the sample at the start of the step and predict its end."""
        eq = self.equations
        self.state, estimate = self.observer.step(
            self.state, self.values(eq.inputs), self.values(eq.outputs), step_size
        )
        return _outputs(estimate)


def _outputs(estimate: Estimate) -> list[Any]:
    return [*estimate.x_hat, *estimate.d_hat, *estimate.d_at_sample, *estimate.residual, estimate.valid]
