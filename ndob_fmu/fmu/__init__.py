"""Package a model as FMUs: bundle what runs inside, build with pythonfmu, complete the model description, repack."""

from ndob_fmu.fmu.build import build

__all__ = ["build"]
