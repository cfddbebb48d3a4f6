"""An FMU's library, called raw through ctypes: nothing between the walk and the FMU that would refuse a call first."""

from __future__ import annotations

import ctypes
import xml.etree.ElementTree as ElementTree
from ctypes import byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from pathlib import Path

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
VALUE = {"Real": c_double, "Integer": c_int, "Boolean": c_int, "String": c_char_p}
_LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions; the FMUs ask the host for no memory."""

    _fields_ = (
        ("logger", c_void_p),
        ("allocate_memory", c_void_p),
        ("free_memory", c_void_p),
        ("step_finished", c_void_p),
        ("environment", c_void_p),
    )


@dataclass(frozen=True)
class Variable:
    """A variable of the model description; items are an enumeration's numbers."""

    reference: int
    name: str
    type: str
    causality: str
    start: float | int | None
    least: float | None
    most: float | None
    items: tuple[int, ...]


class Library:
    """An unpacked FMU; `said` collects its messages: instance, status and text."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        root = ElementTree.parse(folder / "modelDescription.xml").getroot()
        self.guid = root.get("guid")
        self.name = root.find("CoSimulation").get("modelIdentifier")
        self.resources = (folder / "resources").as_uri()
        self.is_native = not (folder / "resources").is_dir()  # such an FMU needs no files
        self.variables = _variables(root)
        self.functions = ctypes.CDLL(str(folder / "binaries" / "linux64" / f"{self.name}.so"))
        self.functions.fmi2Instantiate.restype = c_void_p
        self.functions.fmi2FreeInstance.restype = None
        self.said: list[tuple[str, int, str]] = []
        self._logger = _LOGGER(self._receive)  # ctypes calls it as long as somebody holds it
        self.callbacks = Callbacks(ctypes.cast(self._logger, c_void_p))
        self.silent = Callbacks(None)

    def __getattr__(self, function: str):
        """Return the FMI function `function` without its prefix; it gives the status."""
        return getattr(self.functions, f"fmi2{function}")

    def references(self, type_: str, *causalities: str) -> list[int]:
        return [v.reference for v in self.variables if v.type == type_ and v.causality in causalities]

    def instantiate(self, name: str | None, guid=None, location=None, type_=1, callbacks=None, logging=0) -> int | None:
        name_bytes = None if name is None else name.encode()
        return self.Instantiate(
            c_char_p(name_bytes),
            c_int(type_),
            c_char_p(guid),
            c_char_p(location),
            byref(callbacks) if callbacks else None,
            c_int(0),
            c_int(logging),
        )

    def new(self, name: str = "instance", logging=0) -> c_void_p:
        """Instantiate as a host should."""
        handle = self.instantiate(name, self.guid.encode(), self.resources.encode(), 1, self.callbacks, logging)
        assert handle, f"{self.name} cannot be instantiated"
        return c_void_p(handle)

    def get(self, handle: c_void_p, references: list[int], type_: str = "Real") -> tuple[int, tuple]:
        values = (VALUE[type_] * len(references))()
        function = getattr(self, f"Get{type_}")
        return function(handle, _references(references), c_size_t(len(references)), values), tuple(values)

    def set(self, handle: c_void_p, references: list[int], values, type_: str = "Real") -> int:
        function = getattr(self, f"Set{type_}")
        passed = (VALUE[type_] * len(references))(*values)
        return function(handle, _references(references), c_size_t(len(references)), passed)

    def setup(self, handle: c_void_p, start: float, stop: float | None = None, tolerance: float = 0.0) -> int:
        return self.SetupExperiment(
            handle,
            c_int(tolerance != 0.0),
            c_double(tolerance),
            c_double(start),
            c_int(stop is not None),
            c_double(0.0 if stop is None else stop),
        )

    def step(self, handle: c_void_p, time: float, size: float) -> int:
        return self.DoStep(handle, c_double(time), c_double(size), c_int(1))

    def begin(self, handle: c_void_p) -> None:
        """Go to step mode with all as it is declared."""
        assert self.setup(handle, 0.0) == OK
        assert self.EnterInitializationMode(handle) == OK
        assert self.ExitInitializationMode(handle) == OK

    def _receive(self, _environment, name, status, _category, message) -> None:
        self.said.append((name.decode(), status, message.decode()))


def _references(references: list[int]):
    return (c_uint * len(references))(*references)


def _variables(root) -> list[Variable]:
    items = {
        simple.get("name"): tuple(int(item.get("value")) for item in simple.iter("Item"))
        for simple in root.iter("SimpleType")
    }
    found = []
    for scalar in root.iter("ScalarVariable"):
        kind = next(child for child in scalar if child.tag in (*VALUE, "Enumeration"))
        number = float if kind.tag == "Real" else int
        start, least, most = (
            None if (text := kind.get(key)) is None or kind.tag in ("Boolean", "String") else number(text)
            for key in ("start", "min", "max")
        )
        found.append(
            Variable(
                int(scalar.get("valueReference")),
                scalar.get("name"),
                "Integer" if kind.tag == "Enumeration" else kind.tag,
                scalar.get("causality"),
                start,
                least,
                most,
                items.get(kind.get("declaredType"), ()),
            )
        )
    return found
