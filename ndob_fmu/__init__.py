"""Nonlinear disturbance observer: from a symbolic plant model to FMUs, and to the coupled simulation of both."""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

# Loaded on first use, so that the core that runs inside an FMU pulls in neither SymPy, SciPy, fmpy nor pythonfmu.
_HOME = {
    "Model": "ndob_fmu.model.model",
    "ObserverDefaults": "ndob_fmu.runtime.equations",
    "SignalDefaults": "ndob_fmu.runtime.equations",
    "Experiment": "ndob_fmu.runtime.equations",
    "load_model": "ndob_fmu.model.loading",
    "check": "ndob_fmu.analysis.assumptions",
    "design": "ndob_fmu.analysis.design",
    "build": "ndob_fmu.fmu",
    "simulate": "ndob_fmu.cosim",
    "System": "ndob_fmu.cosim",
    "FmuComponent": "ndob_fmu.cosim",
    "write_ssp": "ndob_fmu.packages",
    "NdobError": "ndob_fmu.errors",
}
__all__ = [
    "Experiment",
    "FmuComponent",
    "Model",
    "NdobError",
    "ObserverDefaults",
    "SignalDefaults",
    "System",
    "__version__",
    "build",
    "check",
    "design",
    "load_model",
    "simulate",
    "write_ssp",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'ndob_fmu' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})  # a prompt completes the names that are not loaded yet
