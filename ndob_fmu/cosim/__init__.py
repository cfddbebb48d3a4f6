"""Coupled simulation of FMUs: any FMI 2.0 co-simulation FMUs, wired in Python or by an SSP package."""

from ndob_fmu.cosim.component import Component, Value, Variable
from ndob_fmu.cosim.fmi.fmu_component import FmuComponent
from ndob_fmu.cosim.simulation import open_system, simulate, start_values_of_components
from ndob_fmu.cosim.ssp import check_ssp, open_ssp, parameter_sets
from ndob_fmu.cosim.system.loops import AlgebraicLoop, algebraic_loops
from ndob_fmu.cosim.system.ports import Connection, Port
from ndob_fmu.cosim.system.system import System
from ndob_fmu.results.recording import Recording

__all__ = [
    "AlgebraicLoop",
    "Component",
    "Connection",
    "FmuComponent",
    "Port",
    "Recording",
    "System",
    "Value",
    "Variable",
    "algebraic_loops",
    "check_ssp",
    "open_ssp",
    "open_system",
    "parameter_sets",
    "simulate",
    "start_values_of_components",
]
