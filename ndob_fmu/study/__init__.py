"""Parameter studies: many runs of one system on many workers, kept as they finish."""

from ndob_fmu.study.study import Study
from ndob_fmu.study.study_file import read_study
from ndob_fmu.study.sweep import sweep

__all__ = ["Study", "read_study", "sweep"]
