"""Package a model as FMUs: describe it, bundle the code that runs inside, compile the front, write the archive."""

from ndob_fmu.fmu.build import build

__all__ = ["build"]
