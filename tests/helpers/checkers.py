"""What tools that check FMUs say: fmpy and fmu-manipulation-toolbox."""

from __future__ import annotations

import logging

from fmpy.validation import validate_fmu
from fmu_manipulation_toolbox.checker import get_checkers
from fmu_manipulation_toolbox.operations import FMU


def findings(fmu):
    """Return what `fmpy validate` and `fmutool -check` say of the FMU."""
    return [*validate_fmu(str(fmu)), *toolbox_findings(fmu)]


def toolbox_findings(fmu):
    """Return what `fmutool -check` would log as errors or warnings."""
    found = []

    class Findings(logging.Handler):
        def emit(self, record):
            found.append(record.getMessage())

    handler, logger = Findings(logging.WARNING), logging.getLogger("fmu_manipulation_toolbox")
    logger.addHandler(handler)
    try:
        with FMU(str(fmu)) as unpacked:
            for checker in get_checkers():
                unpacked.apply_operation(checker())
    finally:
        logger.removeHandler(handler)
    return found
