"""The messages of an FMU: they go to Python's logging, and the latest one into error messages."""

from __future__ import annotations

import logging
from ctypes import byref
from importlib import import_module
from types import ModuleType
from typing import Any

from fmpy import calloc, fmi2, free

_PROXY: ModuleType | None
try:
    _PROXY = import_module("fmpy.logging")
except OSError:  # fmpy ships its library for some platforms only
    _PROXY = None

_log = logging.getLogger("ndob_fmu.fmu")
# A message with a worse status is part of the exception; it must not be shown twice.
_LEVELS = {fmi2.fmi2OK: logging.DEBUG, fmi2.fmi2Warning: logging.WARNING}
_open: dict[int, FmuLog] = {}


class FmuLog:
    """The callbacks for one instance; ``last`` is its latest message with another status than OK.

    Held open by ``open`` and ``close``, between which the FMU may call back.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.last = ""
        self.callbacks = fmi2.fmi2CallbackFunctions()

    def open(self) -> None:
        """Make the callbacks valid."""
        self.callbacks.logger = _ROUTE
        self.callbacks.allocateMemory = _ALLOCATE
        self.callbacks.freeMemory = _FREE
        self.callbacks.componentEnvironment = id(self)
        if _PROXY is not None:
            _PROXY.addLoggerProxy(byref(self.callbacks))
        _open[id(self)] = self

    def close(self) -> None:
        """Forget the instance; the FMU must be gone."""
        _open.pop(id(self), None)

    def receive(self, status: int, message: bytes | None) -> None:
        """Take one message of the FMU."""
        text = " ".join((message or b"").decode("utf-8", "replace").split())
        if status != fmi2.fmi2OK:
            self.last = text
        _log.log(_LEVELS.get(status, logging.INFO), "%s: %s", self.name, text)


def _route(environment: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
    """Hand a message to the instance it is from.

    fmpy's proxy, which expands the printf arguments that ctypes cannot receive, keeps one logger for the whole
    process. So ours stands in for fmpy's, and leaves to it what comes from instances that are not ours.
    """
    log = _open.get(environment or 0)
    if log is None:
        fmi2.printLogMessage(environment, name, status, category, message)
    else:
        log.receive(status, message)


# Kept for the life of the process: C code holds pointers to them.
_ROUTE: Any = fmi2.fmi2CallbackLoggerTYPE(_route)
_ALLOCATE: Any = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
_FREE: Any = fmi2.fmi2CallbackFreeMemoryTYPE(free)
