"""System structure packages (SSP 1.0): read, written, packed and checked."""

from ndob_fmu.cosim.ssp.check import check_ssp
from ndob_fmu.cosim.ssp.pack import parameter_sets
from ndob_fmu.cosim.ssp.read_package import open_ssp

__all__ = ["check_ssp", "open_ssp", "parameter_sets"]
