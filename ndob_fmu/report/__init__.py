"""One HTML page of the results of a run or a study, which works offline: plots, summary, parameters, versions."""

from ndob_fmu.report.page import write_report

__all__ = ["write_report"]
