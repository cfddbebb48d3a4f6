"""A native observer over many rows in one call, in this process: FMI 2.0 and `ndobManySteps` of the FMU's library."""

from __future__ import annotations

import ctypes
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.interface.model_variables import observer_variables
from ndob_fmu.interface.variables import Variable
from ndob_fmu.model.model import Model
from ndob_fmu.native.compile import PLATFORMS, this_platform
from ndob_fmu.native.kept_observer import kept_observer
from ndob_fmu.native.origin import ORIGIN, origin
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.support.temporary import temporary_folder

_CO_SIMULATION, _WARNING = 1, 1
# A call cannot be interrupted; these take some tenths of a second at most.
_ROWS_OF_A_CALL = 2000
_MOST_OF_TUNING = 1000
_Logger = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
_SETTERS: Mapping[str, tuple[str, Any]] = {
    "Real": ("fmi2SetReal", ctypes.c_double * 1),
    "Integer": ("fmi2SetInteger", ctypes.c_int * 1),
    "Enumeration": ("fmi2SetInteger", ctypes.c_int * 1),
    "Boolean": ("fmi2SetBoolean", ctypes.c_int * 1),
}


class _Callbacks(ctypes.Structure):
    _fields_ = (
        ("logger", _Logger),
        *((name, ctypes.c_void_p) for name in ("allocate", "free", "step_finished", "environment")),
    )


class _Steps(ctypes.Structure):
    """As `ndobSteps` in shell/many_steps.c."""

    _fields_ = (
        ("count", ctypes.c_size_t),
        ("lengths", ctypes.c_void_p),
        ("input_count", ctypes.c_size_t),
        ("inputs", ctypes.c_void_p),
        ("given_count", ctypes.c_size_t),
        ("given_at", ctypes.c_void_p),
        ("given", ctypes.c_void_p),
        ("read_count", ctypes.c_size_t),
        ("read_at", ctypes.c_void_p),
        ("found", ctypes.c_void_p),
    )


class NativeObserver:
    """An instance of `<Name>Observer`, in the state before its first step."""

    def __init__(self, library: Path, guid: str, variables: Sequence[Variable], values: Mapping[str, Any]) -> None:
        """Start an instance with these values of its parameters. Raises OSError where that is impossible."""
        self._said: list[str] = []
        self._library = ctypes.CDLL(str(library))
        self._library.fmi2Instantiate.restype = ctypes.c_void_p
        self._library.ndobManySteps.restype = self._library.ndobTuning.restype = ctypes.c_size_t
        # The library keeps the address.
        self._callbacks = _Callbacks(_Logger(self._log), None, None, None, None)
        component = self._library.fmi2Instantiate(
            b"log", _CO_SIMULATION, guid.encode(), b"", ctypes.byref(self._callbacks), 0, 1
        )
        if component is None:
            raise OSError("no instance")
        self._component = ctypes.c_void_p(component)
        self._inputs = sum(variable.causality == "input" for variable in variables)
        self._outputs = sum(variable.causality == "output" for variable in variables)
        good = self._call("fmi2SetupExperiment", 0, ctypes.c_double(0.0), ctypes.c_double(0.0), 0, ctypes.c_double(0.0))
        for reference, variable in enumerate(variables):
            if variable.causality == "parameter":
                setter, array = _SETTERS[variable.type]
                value = array(values[variable.name])
                good &= self._call(setter, (ctypes.c_uint32 * 1)(reference), ctypes.c_size_t(1), value)
        good &= self._call("fmi2EnterInitializationMode") and self._call("fmi2ExitInitializationMode")
        if not good:
            self.end()
            raise OSError("; ".join(self._said))

    def steps(
        self, lengths: Array, inputs: Array, read: NDArray[np.uint32], given: Mapping[int, float] | None = None
    ) -> tuple[Array, Array]:
        """Take steps (K,) s from samples; return the outputs (K,·) of each, and numbers (K,·) of the state behind it.

        inputs (K,·): all inputs, in their order
        read: places of numbers in `SampledObserverState`, written one behind the other
        given: numbers to put there first, by their places

        Raises IntegrationError where a step is refused.
        """
        count, width = len(lengths), self._outputs + len(read)
        found, given = np.empty((count, width)), given or {}
        lengths, inputs = np.ascontiguousarray(lengths, dtype=float), np.ascontiguousarray(inputs, dtype=float)
        # The state begins with the count of its numbers.
        given_at, read_at = np.array([*given], dtype=np.uint32) + np.uint32(1), read.astype(np.uint32) + np.uint32(1)
        values = np.array([*given.values()], dtype=float)
        for first in range(0, count, _ROWS_OF_A_CALL):
            some = slice(first, first + _ROWS_OF_A_CALL)
            wanted = len(lengths[some])
            steps = _Steps(
                wanted,
                lengths[some].ctypes.data,
                self._inputs,
                inputs[some].ctypes.data,
                0 if first else len(given),
                given_at.ctypes.data,
                values.ctypes.data,
                len(read),
                read_at.ctypes.data,
                found[some].ctypes.data,
            )
            if self._library.ndobManySteps(self._component, ctypes.byref(steps)) < wanted:
                raise IntegrationError(self._said[-1] if self._said else "the observer refuses a step")
        return found[:, : self._outputs], found[:, self._outputs :]

    def tuning(self) -> list[float]:
        """Return what the last step was tuned to, as `tuning` in component/observer.c writes it; empty for nothing."""
        numbers = (ctypes.c_double * _MOST_OF_TUNING)()
        return numbers[: self._library.ndobTuning(self._component, numbers, ctypes.c_size_t(_MOST_OF_TUNING))]

    def end(self) -> None:
        """Free the instance."""
        self._library.fmi2FreeInstance(self._component)

    def _call(self, function: str, *arguments: Any) -> bool:
        return bool(getattr(self._library, function)(self._component, *arguments) <= _WARNING)

    def _log(self, environment: int, name: bytes, status: int, category: bytes, message: bytes) -> None:
        if status > _WARNING:
            self._said.append(message.decode("utf-8", "replace").replace("%%", "%"))


@contextmanager
def native_observer(
    model: Model, folder: Path, values: Mapping[str, Any], *, builds: bool = False
) -> Iterator[NativeObserver | None]:
    """Yield an instance of the native observer that `build_native` has written into a folder, for FMI 2.0.

    values: of all parameters
    builds: whether one is built for the cache folder where there is none

    Where there is no FMU of this model for this platform that this version of the package has made, it is the one that
    `kept_observer` finds. It is None where that has none, and where the library cannot be loaded.
    """
    with temporary_folder() as work:
        found = _unpacked(model, folder / f"{model.name}Observer.fmu", work)
        if found is None and (own := kept_observer(model, work, builds=builds)) is not None:
            found = _unpacked(model, own, work)
        instance = None
        if found is not None:
            with suppress(OSError, AttributeError):
                instance = NativeObserver(*found, observer_variables(compile_model(model)), values)
        try:
            yield instance
        finally:
            if instance is not None:
                instance.end()


def _unpacked(model: Model, fmu: Path, work: Path) -> tuple[Path, str] | None:
    """Return the library of a model's observer in an FMU, and the FMU's GUID; None where it has none."""
    here = PLATFORMS.get(this_platform())
    if here is None:
        return None
    try:
        with zipfile.ZipFile(fmu) as archive:
            if archive.read(ORIGIN) != origin(model):
                return None
            guid = ElementTree.fromstring(archive.read("modelDescription.xml")).get("guid")
            binary = archive.read(f"binaries/{here.folders[0]}/{fmu.stem}{here.suffix}")
    except (OSError, KeyError, zipfile.BadZipFile, ElementTree.ParseError):
        return None
    if guid is None:
        return None
    library = work / f"{fmu.stem}{here.suffix}"
    library.write_bytes(binary)
    return library, guid
