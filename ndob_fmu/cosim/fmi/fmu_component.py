"""An FMI 2.0 co-simulation FMU as a component."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fmpy import fmi2
from fmpy.fmi1 import FMICallException

from ndob_fmu.cosim.component import Ended, Value, Variable, recordable
from ndob_fmu.cosim.default_experiment import DefaultExperiment
from ndob_fmu.cosim.fmi.buffers import Buffer, buffers, fmi_call
from ndob_fmu.cosim.fmi.instance import NoInstanceError, instantiate
from ndob_fmu.cosim.fmi.log import FmuLog
from ndob_fmu.cosim.fmi.model_description import read_description
from ndob_fmu.cosim.fmi.zip_archive import open_archive
from ndob_fmu.errors import NdobError, SimulationError
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.temporary import make_folder, remove_folder

_log = logging.getLogger(__name__)
_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")


class FmuComponent:
    """One FMU; an instance of it exists from ``setup`` to ``close``, unpacked in a temporary folder of its own.

    Making one reads the model description only. Raises UsageError if there is no such file, CouplingError if it is not
    an FMU for FMI 2.0 co-simulation; the calls of the component raise SimulationError naming component, time and the
    FMU's last message.
    """

    def __init__(self, path: str | Path, name: str | None = None) -> None:
        self.path = Path(path)
        self.name = name or self.path.stem
        try:
            self._description = read_description(self.path)
        except NdobError as error:
            raise type(error)(f"component {self.name}: {error}") from error
        self._types = {variable.name: variable.type for variable in self.variables}
        self._log = FmuLog(self.name)
        self._folder: Path | None = None
        self._fmu: Any = None
        self._initialized = False
        self._keep = False
        self._worst_status = fmi2.fmi2OK
        self._time = 0.0
        self._inputs: list[Buffer] = []
        self._outputs: list[Buffer] = []
        self._set_from: Array | None = None
        self._got_into: Array | None = None
        self._begin, self._duration = fmi2.fmi2Real(), fmi2.fmi2Real()
        self._do_step: Callable[[], None]
        self._setters: list[Callable[[], None]] = []
        self._getters: list[Callable[[], None]] = []

    @property
    def variables(self) -> Sequence[Variable]:
        """Every variable of the model description, in its order."""
        return self._description.variables

    @property
    def model_identifier(self) -> str:
        """The model identifier of the model description, also where the file has another name."""
        return self._description.model_identifier

    @property
    def generation_tool(self) -> str:
        """What made the FMU, as its model description says; empty where it does not say."""
        return self._description.generation_tool

    @property
    def experiment(self) -> DefaultExperiment:
        """The FMU's default experiment."""
        return self._description.experiment

    def setup(
        self,
        start_time: float,
        stop_time: float,
        start_values: Mapping[str, Value],
        inputs: Sequence[str],
        tolerance: float | None = None,
    ) -> None:
        """Unpack, load and instantiate the FMU, give it its start values and enter initialization mode.

        tolerance: relative; None takes that of the FMU's default experiment, if it has one.
        """
        self._time, self._worst_status = start_time, fmi2.fmi2OK
        self._log.last = ""
        if self._fmu is None:
            self._log.open()
            self._folder = make_folder()
            with open_archive(self.path) as archive:
                archive.extractall(self._folder)
            try:
                self._fmu = instantiate(self._folder, self.name, self._description, self._log.callbacks)
            except NoInstanceError as error:
                received = error.received.replace(str(self._folder), self.path.name)
                raise self._refusal(error.expected, received) from error
            always = fmi2.fmi2Boolean(fmi2.fmi2True)
            self._do_step = fmi_call(self._fmu, "fmi2DoStep", self._begin, self._duration, always)
        self._call(self._fmu.setupExperiment, tolerance or self.experiment.tolerance, start_time, stop_time)
        for buffer in self._buffers(tuple(start_values)):
            buffer.load([start_values[name] for name in buffer.names])
            self._call(buffer.set, self._fmu)
        strings = {name: value for name, value in start_values.items() if self._types[name] == "String"}
        if strings:
            self._call(self._fmu.setString, [self._description.references[name] for name in strings], strings.values())
        self._inputs = self._buffers(inputs)
        self._outputs = self._buffers([variable.name for variable in recordable(self.variables)])
        self._call(self._fmu.enterInitializationMode)

    def set_inputs(self, values: Array) -> None:
        """Set the inputs announced to ``setup``, (len(inputs),), with one FMI call for each type.

        The calls are prepared for the array of the first call; another array makes them anew, which costs more.
        """
        if values is not self._set_from:
            self._setters = [buffer.setter(self._fmu, values) for buffer in self._inputs]
            self._set_from = values
        try:
            for set_values in self._setters:
                set_values()
        except FMICallException as error:
            raise self._failure(error) from error

    def get_outputs(self, values: Array) -> None:
        """Write the numeric outputs into ``values``, with one FMI call for each type; prepared as in ``set_inputs``."""
        if values is not self._got_into:
            self._getters = [buffer.getter(self._fmu, values) for buffer in self._outputs]
            self._got_into = values
        try:
            for get_values in self._getters:
                get_values()
        except FMICallException as error:
            raise self._failure(error) from error

    def initialize(self) -> None:
        """Leave initialization mode."""
        self._call(self._fmu.exitInitializationMode)
        self._initialized = True

    def step(self, time: float, step_size: float) -> Ended | None:
        """Do one communication step of ``step_size`` from ``time`` (s); return whether the FMU ended the simulation."""
        self._time = time
        try:
            self._begin.value, self._duration.value = time, step_size
            self._do_step()
        except FMICallException as error:
            ended = self._ended(time, step_size) if error.status == fmi2.fmi2Discard else None
            if ended is None:
                raise self._failure(error) from error
            return ended
        self._time = time + step_size
        return None

    def _ended(self, time: float, step_size: float) -> Ended | None:
        """Return whether the FMU has discarded the step from ``time`` (s) because it wants to end the simulation.

        FMI 2.0, section 4.2.3: fmi2Terminated says whether, fmi2LastSuccessfulTime when. The outputs are those at that
        time.
        """
        reason = self._log.last
        try:
            if not self._fmu.getBooleanStatus(fmi2.fmi2Terminated):
                return None
        except FMICallException:  # the question is optional for FMUs
            return None
        finally:
            self._log.last = reason  # and not a message about the status calls
        last = time
        with suppress(FMICallException):
            last = float(self._fmu.getRealStatus(fmi2.fmi2LastSuccessfulTime))
        self._time = min(max(last, time), time + step_size) if math.isfinite(last) else time
        return Ended(self._time, reason)

    def close(self) -> None:
        """Terminate and free the instance and delete its folder; after a fatal status FMI allows the last only."""
        if self._fmu is not None and self._initialized and self._worst_status < fmi2.fmi2Error:
            self._try(self._fmu.terminate)
        self._initialized = False
        self._forget_arrays()
        if self._keep and self._fmu is not None and self._worst_status < fmi2.fmi2Error and self._try(self._fmu.reset):
            return
        fmu, self._fmu = self._fmu, None
        try:
            if fmu is not None and self._worst_status < fmi2.fmi2Fatal:
                fmu.freeInstance()
        finally:
            self._log.close()
            if self._folder is not None:
                remove_folder(self._folder)
                self._folder = None

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep the instance from run to run until the end of the block: ``close`` resets one that has not failed.

        So the FMU is unpacked, loaded and instantiated once for many short runs.
        """
        self._keep = True
        try:
            yield
        finally:
            self._keep = False
            self.close()

    def _try(self, function: Callable[[], Any]) -> bool:
        try:
            function()
        except FMICallException as error:
            self._worst_status = max(self._worst_status, error.status)
            _log.warning("%s: %s", self.name, error)
            return False
        return True

    def _forget_arrays(self) -> None:
        self._set_from = self._got_into = None
        self._setters, self._getters = [], []

    def _buffers(self, names: Sequence[str]) -> list[Buffer]:
        return buffers(names, self._types, self._description.references)

    def _call(self, function: Callable[..., Any], *arguments: Any) -> None:
        try:
            function(*arguments)
        except FMICallException as error:
            raise self._failure(error) from error

    def _failure(self, error: FMICallException) -> NdobError:
        self._worst_status = max(self._worst_status, error.status)
        status = _STATUS[error.status] if error.status < len(_STATUS) else f"status {error.status}"
        return self._refusal(f"{error.function} to succeed", status)

    def _refusal(self, expected: str, received: str) -> NdobError:
        where = f"component {self.name} at t = {self._time:.12g} s"
        return SimulationError.report(where, expected=expected, received=received, likely=self._log.last)
