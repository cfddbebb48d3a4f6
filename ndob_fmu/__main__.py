"""`python -m ndob_fmu`."""

from ndob_fmu.cli import run_and_leave

run_and_leave()
