"""An FMU driven by name through fmpy, call by call, with the status of each call and the FMU's messages."""

from __future__ import annotations

import ctypes
import tempfile
from contextlib import contextmanager

import fmpy
from fmpy import fmi2
from fmpy.fmi1 import FMICallException

from ndob_fmu.cosim.fmi.log import FmuLog

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
_ACCESS = {"Real": "Real", "Integer": "Integer", "Enumeration": "Integer", "Boolean": "Boolean", "String": "String"}


class Instance:
    """Calls return the status; `get` returns numbers by name; `said` collects the messages."""

    def __init__(self, path, folder, name="instance"):
        self.description = fmpy.read_model_description(path)
        self.variables = {variable.name: variable for variable in self.description.modelVariables}
        self.log = FmuLog(name)
        self.said = []
        receive = self.log.receive
        self.log.receive = lambda status, message: (self.said.append(message.decode()), receive(status, message))
        self.log.open()
        self.fmu = fmi2.FMU2Slave(
            instanceName=name,
            guid=self.description.guid,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            unzipDirectory=folder,
        )
        self.fmu.instantiate(callbacks=self.log.callbacks, loggingOn=True)

    def __getattr__(self, function):
        """Return the FMI function `function` as fmpy calls it; it returns the status."""
        call = getattr(self.fmu, function)

        def status(*arguments, **named):
            try:
                call(*arguments, **named)
            except FMICallException as error:
                return error.status
            return OK

        return status

    def begin(self, start_time=0.0, stop_time=None, **parameters):
        """Go to step mode."""
        assert self.setupExperiment(startTime=start_time, stopTime=stop_time) == OK
        assert [self.set(name, value) for name, value in parameters.items()] == [OK] * len(parameters)
        assert self.enterInitializationMode() == OK
        assert self.exitInitializationMode() == OK

    def set(self, name, value):
        variable = self.variables[name]
        return getattr(self, f"set{_ACCESS[variable.type]}")([variable.valueReference], [value])

    def get(self):
        """Return all outputs, by name."""
        outputs = [v for v in self.variables.values() if v.causality == "output"]
        values = {}
        for kind in ("Real", "Boolean"):
            of_kind = [v for v in outputs if v.type == kind]
            read = getattr(self.fmu, f"get{kind}")([v.valueReference for v in of_kind])
            values.update(zip([v.name for v in of_kind], read, strict=True))
        return values

    def step(self, t, H, **inputs):
        """Set inputs, step, and return the outputs."""
        for name, value in inputs.items():
            assert self.set(name, value) == OK
        assert self.doStep(t, H) == OK, self.said
        return self.get()

    def state(self):
        return self.fmu.getFMUState()

    def bytes_of(self, state):
        return bytes(self.fmu.serializeFMUState(state))

    def from_bytes(self, data):
        """Return the status and the state."""
        state = ctypes.c_void_p()
        buffer = ctypes.create_string_buffer(data, len(data))
        function = self.fmu.dll.fmi2DeSerializeFMUstate
        return function(self.fmu.component, buffer, ctypes.c_size_t(len(data)), ctypes.byref(state)), state


@contextmanager
def unpacked(path):
    """The folder of an FMU, and a function that makes instances of it, which end with the context."""
    instances = []
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as folder:
        fmpy.extract(path, folder)

        def instance(name="instance"):
            instances.append(Instance(path, folder, name))
            return instances[-1]

        yield instance
        for each in instances:
            each.fmu.freeInstance()
            each.log.close()


@contextmanager
def opened(path):
    """One instance of the FMU."""
    with unpacked(path) as instance:
        yield instance()
