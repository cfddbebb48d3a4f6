"""`<Name>Observer`: the disturbance observer, one step of the core per doStep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf, isfinite
from typing import Any

from pythonfmu.enums import Fmi2Status

from fmus.slave_base import Slave
from ndob_fmu.interface.model_variables import METHODS, observer_variables
from ndob_fmu.interface.told_observer import for_disturbances, told_observer
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.design.lumping import lumped, lumped_bound, lumped_nominal
from ndob_fmu.runtime.design.pace import pace_of, pace_warnings
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.numerics.hold import History
from ndob_fmu.runtime.step.channel_observer import ChannelState, read_out
from ndob_fmu.runtime.step.error_columns import ErrorColumns
from ndob_fmu.runtime.step.filter_state import (
    FilterMemory,
    JumpBank,
    LagMemory,
    SampledObserverState,
    SensorMemory,
)
from ndob_fmu.runtime.step.observer import Estimate, Observer
from ndob_fmu.runtime.step.paper_observer import PaperObserver, PaperObserverState, paper_observer
from ndob_fmu.runtime.step.sampled_observer import SampledObserver

# Takes state, inputs with outputs, and the step size; returns the state and the slave's outputs, or None.
_QuickStep = Callable[[Any, Sequence[float], float], tuple[Any, Sequence[Any], Any] | None]


class ObserverSlave(Slave):
    """Prepares the observer of the chosen method from the parameters when initialization ends, then steps it."""

    state_types = (
        *(SampledObserverState, FilterMemory, ErrorColumns, JumpBank, SensorMemory, LagMemory),
        *(PaperObserverState, History, ChannelState),
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
            lag=0.0 if quick is None else self.value("lag"),
        )
        # A channel that depends on the state is read out after each step, which the quick step would leave out.
        self._step_converged = quick if self.observer is observer else None
        self.state = self.observer.init(self._for_states("hat_start"))
        self._has_stepped = False
        self._outside: set[str] = set()

    def possible(self, state: Any, begin: float, now: float) -> bool:
        """Whether the observer can be in such a state."""
        return self.observer.possible(state)

    def show(self) -> Sequence[Any]:
        """Return the estimate that the first sample alone gives."""
        eq, state = self.equations, self.state
        if any(eq.feedthrough) and isinstance(state, SampledObserverState):
            state = replace(state, u=tuple(self.values(eq.inputs)))
        return _outputs(self.observer.estimate(state, self.values(eq.outputs)))

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
        if not self._has_stepped:
            self._has_stepped = True
            self._warn_of_pace(step_size)
        self.state, estimate = self.observer.step(self.state, u, y, step_size)
        self._warn_of_ranges(estimate.x_hat)
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
            disturbance_nominal=lumped_nominal(self.equations, self._for_disturbances("disturbance_nominal")),
        )

    def _sampled(self) -> SampledObserver:
        return told_observer(self.equations, self.value, lambda text: self.log(text, Fmi2Status.warning))

    def _warn_of_pace(self, step_size: float) -> None:
        """Log where the rate of the disturbance or the step is absurd for the plant; method 1 uses no rate."""
        if self.value("method") == METHODS["paper"]:
            return
        eq = self.equations
        pace = pace_of(
            eq,
            self.values(eq.parameters),
            self._for_states("hat_start"),
            bound=self._for_disturbances("disturbance_bound"),
            rate=self._for_disturbances("disturbance_rate"),
            order=self.value("disturbance_order"),
        )
        for text in pace_warnings(pace, eq.disturbances, step_size):
            self.log(text, Fmi2Status.warning)

    def _warn_of_ranges(self, x_hat: Vector) -> None:
        """Log once of each state that its estimate has left its range."""
        for name, value in zip(self.equations.states, x_hat, strict=True):
            low, high = self.equations.ranges.get(name, (-inf, inf))
            if name not in self._outside and not low <= value <= high:
                self._outside.add(name)
                self.log(
                    f"the estimate of {name}, {value:.4g}, is outside its range, {low:g} to {high:g}: equations are "
                    f"continued by their tangent there; if {name} has left it too, a wider range is needed",
                    Fmi2Status.warning,
                )

    def _for_states(self, suffix: str) -> list[float]:
        return self.values(f"{name}_{suffix}" for name in self.equations.states)

    def _for_outputs(self, suffix: str) -> list[float]:
        return self.values(f"{name}_{suffix}" for name in self.equations.outputs)

    def _for_disturbances(self, name: str) -> list[float]:
        return for_disturbances(self.equations, self.value, name)


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
