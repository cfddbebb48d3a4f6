"""What the entry script of an FMU needs to survive being run once more for every instance."""

from __future__ import annotations

from ctypes import py_object, pythonapi
from typing import Any


def add_reference(entry_globals: dict[str, Any]) -> None:
    """Add the reference to these globals that pythonfmu's binary gives up without having it, each time it runs them.

    Without it the globals are freed, and the next run or Python's end crashes the host. A reference that any object
    held would not do: the garbage collector and the clearing of modules at Python's end count on those being real.
    """
    pythonapi.Py_IncRef(py_object(entry_globals))
