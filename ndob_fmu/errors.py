"""Every error of the package, one line each: what was expected, what was received, the likely cause."""

from __future__ import annotations

from ndob_fmu.runtime.errors import AssumptionError, DesignError, NdobError


class UsageError(NdobError):
    """A value or a name given by the caller cannot be used."""


class ModelError(NdobError):
    """A model is missing, cannot be read, or contradicts itself."""


class CouplingError(NdobError):
    """The components of a system cannot be connected as described."""


class SimulationError(NdobError):
    """A component failed while the coupled system ran."""

    exit_code = 1


__all__ = [
    "AssumptionError",
    "CouplingError",
    "DesignError",
    "ModelError",
    "NdobError",
    "SimulationError",
    "UsageError",
]
