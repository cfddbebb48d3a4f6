"""The versions of the software that a result was made with."""

from __future__ import annotations

import platform
from importlib.metadata import version

from ndob_fmu import __version__


def software_versions(*more: str) -> dict[str, str]:
    """Return the versions of Python, of this package, of what every result depends on, and of the packages named."""
    names = ("fmpy", "pythonfmu", "numpy", *more)
    own = {"python": platform.python_version(), "ndob-fmu": __version__}
    return own | {name: version(name) for name in names}
