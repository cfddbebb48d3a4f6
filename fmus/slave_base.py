"""What the plant's and the observer's slave share: variables registered as declared, and when their values are right.

Outputs are computed in initialization mode as soon as they are asked for, and afterwards once per step.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from math import isfinite
from typing import Any

import numpy as np
from pythonfmu import (
    Boolean,
    DefaultExperiment,
    Fmi2Causality,
    Fmi2Initial,
    Fmi2Slave,
    Fmi2Variability,
    Integer,
    Real,
)
from pythonfmu.enums import Fmi2Status

from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.errors import NdobError
from ndob_fmu.runtime.interface import Variable

_TYPES = {"Real": Real, "Boolean": Boolean, "Integer": Integer, "Enumeration": Integer}


class Slave(Fmi2Slave):  # type: ignore[misc] # pythonfmu carries no type information
    """Base of the slaves; a subclass declares its variables, starts its core and advances it."""

    def __init__(self, equations: Equations, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.equations = equations
        self._variables = variables = self.declare()
        experiment = self.equations.experiment
        self.default_experiment = DefaultExperiment(
            start_time=0.0, stop_time=experiment.stop_time, step_size=experiment.step_size
        )
        self.description = self.equations.description
        self._value_reference = {variable.name: index for index, variable in enumerate(variables)}
        self._values: list[Any] = [0.0 if v.start is None else v.start for v in variables]
        self._output_references = [i for i, v in enumerate(variables) if v.causality == "output"]
        self._parameter_references = [i for i, v in enumerate(variables) if v.causality == "parameter"]
        self._started_with: list[Any] | None = None
        self._initializing = False
        self._stale = False
        self._start_time = 0.0
        for index, variable in enumerate(variables):
            self._register(index, variable)

    # -- for the subclass

    @abstractmethod
    def declare(self) -> tuple[Variable, ...]:
        """Return the variables, in the order of their value references."""

    @abstractmethod
    def start(self, start_time: float) -> None:
        """Make the core anew from the parameters. Raises NdobError where they admit none."""

    @abstractmethod
    def show(self) -> Iterable[Any]:
        """Return the outputs at the start, for the inputs set so far, in the order of their declaration."""

    @abstractmethod
    def advance(self, t: float, step_size: float) -> Iterable[Any]:
        """Take one step and return the outputs at its end, in the order of their declaration."""

    def values(self, names: Iterable[str]) -> list[Any]:
        """Return the present values of the named variables."""
        return [self._values[self._value_reference[name]] for name in names]

    def value(self, name: str) -> Any:
        """Return the present value of one variable."""
        return self._values[self._value_reference[name]]

    # -- called by pythonfmu

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """Note the time at which the simulation starts."""
        self._start_time = start_time

    def enter_initialization_mode(self) -> None:
        """From here on the outputs follow parameters and inputs at once."""
        self._initializing = self._stale = True
        self._started_with = None

    def exit_initialization_mode(self) -> None:
        """Fix the parameters. A design that they do not admit ends the instance here, with its reason logged."""
        self._refresh()
        self._initializing = False

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance the core; a step that cannot be taken is logged and discarded."""
        try:
            if not (isfinite(step_size) and step_size > 0.0):
                raise NdobError.report("communication step", expected="a finite time > 0 s", received=repr(step_size))
            # Overflow is found by its result; a host that makes errors of warnings must not see it as one.
            with np.errstate(all="ignore"):
                self._publish(self.advance(current_time, step_size))
        except NdobError as error:
            self.log(str(error), Fmi2Status.discard)
            return False
        return True

    def get_real(self, vrs: list[int]) -> list[float]:
        """Return the values of Real variables."""
        return [float(value) for value in self._get(vrs)]

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Return the values of Boolean variables."""
        return [bool(value) for value in self._get(vrs)]

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Return the values of Integer and Enumeration variables."""
        return [int(value) for value in self._get(vrs)]

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set Real variables."""
        self._set(vrs, values)

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Set Boolean variables."""
        self._set(vrs, values)

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set Integer and Enumeration variables."""
        self._set(vrs, values)

    # -- inside

    def _register(self, index: int, variable: Variable) -> None:
        output = variable.causality == "output"
        exact = variable.causality == "parameter"
        self.register_variable(
            _TYPES[variable.type](
                variable.name,
                causality=Fmi2Causality[variable.causality],
                variability=Fmi2Variability[variable.variability],
                initial=Fmi2Initial.calculated if output else Fmi2Initial.exact if exact else None,
                description=variable.description,
                getter=lambda: self._get([index])[0],
                setter=lambda value: self._set([index], [value]),
            )
        )

    def _get(self, vrs: list[int]) -> list[Any]:
        if self._stale:
            self._refresh()
        values = self._values
        return [values[vr] for vr in vrs]

    def _set(self, vrs: list[int], new: list[Any]) -> None:
        values = self._values
        for vr, value in zip(vrs, new, strict=True):
            values[vr] = value
        self._stale = self._initializing

    def _refresh(self) -> None:
        parameters = [self._values[vr] for vr in self._parameter_references]
        if parameters != self._started_with:
            # An error ends the instance. It is not logged here: pythonfmu logs it, but drops it if there are messages.
            self._check_parameters()
            self.start(self._start_time)
            self._started_with = parameters
        self._publish(self.show())
        self._stale = False

    def _check_parameters(self) -> None:
        for variable in self._variables:
            value = self.value(variable.name)
            if variable.causality != "parameter":
                continue
            if variable.items is not None and value not in variable.items.values():
                allowed = ", ".join(f"{number} ({item})" for item, number in variable.items.items())
                raise NdobError.report(variable.name, expected=f"one of {allowed}", received=repr(value))
            too_small = variable.minimum is not None and value < variable.minimum
            too_large = variable.maximum is not None and value > variable.maximum
            if not isfinite(value) or too_small or too_large:
                least = "" if variable.minimum is None else f" of at least {variable.minimum:g}"
                most = "" if variable.maximum is None else f" and at most {variable.maximum:g}"
                raise NdobError.report(variable.name, expected=f"a finite number{least}{most}", received=repr(value))

    def _publish(self, outputs: Iterable[Any]) -> None:
        for vr, value in zip(self._output_references, outputs, strict=True):
            self._values[vr] = value
