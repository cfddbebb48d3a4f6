"""`<Name>Observer`: the disturbance observer, one step of the core per doStep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

from fmus.slave_base import Slave
from ndob_fmu.interface.model_variables import METHODS, for_each_disturbance, observer_variables
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.design.lumping import lumped, lumped_bound, lumped_rate
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.numerics.hold import History
from ndob_fmu.runtime.step.channel_observer import ChannelState, read_out
from ndob_fmu.runtime.step.filter_state import (
    FilterMemory,
    JumpBank,
    LagMemory,
    SampledObserverState,
    SensorMemory,
)
from ndob_fmu.runtime.step.observer import Estimate, Observer
from ndob_fmu.runtime.step.paper_observer import PaperObserver, PaperObserverState, paper_observer
from ndob_fmu.runtime.step.sampled_observer import SampledObserver, sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings

# Takes state, inputs with outputs, and the step size; returns the state and the slave's outputs, or None.
_QuickStep = Callable[[Any, Sequence[float], float], tuple[Any, Sequence[Any], Any] | None]


class ObserverSlave(Slave):
    """Prepares the observer of the chosen method from the parameters when initialization ends, then steps it."""

    state_types = (
        SampledObserverState,
        FilterMemory,
        JumpBank,
        SensorMemory,
        LagMemory,
        PaperObserverState,
        History,
        ChannelState,
    )

    def __init__(self, equations: Equations, **kwargs: Any) -> None:
        self.equations = equations
        super().__init__(observer_variables(equations), **kwargs)
        self._inputs = self.variables.stretch([*equations.inputs, *equations.outputs])

    def start(self, start_time: float) -> None:
        """Make the observer and start it from the given estimate of the state."""
        observer: Observer[Any]
        quick: _QuickStep | None
        if self.value("method") == METHODS["paper"]:
            observer, quick = self._paper(), None
        else:
            observer = sampled = self._sampled()
            quick = sampled.step_converged
        self.observer: Observer[Any] = read_out(
            self.equations,
            self.values(self.equations.parameters),
            observer,
            disturbance_bound=self._for_disturbances("disturbance_bound"),
        )
        # A channel that depends on the state is read out after each step, which the quick step would leave out.
        self._step_converged = quick if self.observer is observer else None
        self.state = self.observer.init(self._for_states("hat_start"))

    def possible(self, state: Any, begin: float, now: float) -> bool:
        """Whether the observer can be in such a state."""
        return self.observer.possible(state, now - begin)

    def show(self) -> Sequence[Any]:
        """Return the estimate that the first sample alone gives."""
        return _outputs(self.observer.estimate(self.state, self.values(self.equations.outputs)))

    def advance_quickly(self, t: float, step_size: float) -> Sequence[Any] | None:
        """Take the same step once the gain has converged, with a sample inside the gate."""
        if self._step_converged is None:
            return None
        done = self._step_converged(self.state, self.variables.present[self._inputs], step_size)
        if done is None:
            return None
        self.state, outputs, _ = done
        return outputs

    def advance(self, t: float, step_size: float) -> Sequence[Any]:
        """Take in the sample at the start of the step and predict its end.

        Raises IntegrationError where an output leaves the finite numbers.
        """
        eq = self.equations
        u, y = self.values(eq.inputs), self.values(eq.outputs)
        self.state, estimate = self.observer.step(self.state, u, y, step_size)
        outputs = _outputs(estimate)
        if not all(map(isfinite, outputs)):
            raise IntegrationError("the observer's estimate or its error bar leaves the finite numbers")
        return outputs

    def _paper(self) -> PaperObserver:
        return paper_observer(
            lumped(self.equations),
            self.values(self.equations.parameters),
            PiSchedule(*self.values(["pi_start", "pi_end", "pi_ramp_time"])),
            alpha=self.value("alpha"),
            noise_std=self._for_outputs("noise_std"),
            disturbance_bound=lumped_bound(self.equations, self._for_disturbances("disturbance_bound")),
        )

    def _sampled(self) -> SampledObserver:
        order = self.value("disturbance_order")
        bound, rate = (self._for_disturbances(name) for name in ("disturbance_bound", "disturbance_rate"))
        equations = lumped(self.equations)
        settings = observer_settings(
            equations,
            order=order,
            noise_std=self._for_outputs("noise_std"),
            disturbance_bound=lumped_bound(self.equations, bound),
            disturbance_rate=lumped_rate(self.equations, bound, rate, order=order),
            x_std=self._for_states("hat_start_std"),
            alpha=self.value("alpha"),
            pi=self.value("pi_end"),
        )
        return sampled_observer(equations, self.values(equations.parameters), settings, self._for_states("hat_start"))

    def _for_states(self, suffix: str) -> list[float]:
        return self.values(f"{name}_{suffix}" for name in self.equations.states)

    def _for_outputs(self, suffix: str) -> list[float]:
        return self.values(f"{name}_{suffix}" for name in self.equations.outputs)

    def _for_disturbances(self, name: str) -> list[float]:
        return self.values(for_each_disturbance(name, self.equations.disturbances).values())


def _outputs(estimate: Estimate) -> list[Any]:
    return [
        *estimate.x_hat,
        *estimate.d_hat,
        *estimate.d_at_sample,
        *estimate.d_std,
        *estimate.d_lagged,
        *estimate.d_lagged_std,
        *estimate.residual,
        *estimate.residual_std,
        estimate.valid,
        estimate.consistency,
    ]
