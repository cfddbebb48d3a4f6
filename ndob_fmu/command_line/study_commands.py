"""The commands on many runs and on results: sweep, report."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ndob_fmu.command_line.options import Commands, add_command, positive
from ndob_fmu.support.extras import extra
from ndob_fmu.support.interrupts import exit_code


def add_study_commands(commands: Commands) -> None:
    """Add sweep and report."""
    parser = add_command(
        commands, "sweep", _sweep, "Run a parameter study on many workers; continue it if an earlier call was stopped."
    )
    parser.add_argument(
        "study", type=Path, metavar="STUDY.toml", help="description of the study; docs/studies.md explains it"
    )
    parser.add_argument(
        "--system",
        type=Path,
        metavar="PATH",
        help="run this .ssp or .fmu in place of the study's, for example the same system with native FMUs",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the results (default: results/NAME OF STUDY)"
    )
    parser.add_argument(
        "--workers", type=positive, metavar="N", help="processes on this machine (default: one per core)"
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="use a running dask scheduler instead, for example tcp://HOST:8786"
    )
    parser.add_argument("--retry-failed", action="store_true", help="repeat the failed runs")

    parser = add_command(
        commands, "report", _report, "Make one HTML page of the results of a run or a study; it works offline."
    )
    parser.add_argument("results", type=Path, metavar="RESULTS_DIR", help="folder of a run, of the demo or of a study")
    parser.add_argument("--out", type=Path, metavar="FILE", help="page to write (default: RESULTS_DIR/report.html)")


def _sweep(options: argparse.Namespace) -> int:
    with extra("study"):
        from ndob_fmu.study import read_study, sweep
        from ndob_fmu.study.figures import draw_figures
        from ndob_fmu.study.summary import as_text, summarize

    study = read_study(options.study, options.system)
    folder = options.out or Path("results", study.name)
    try:
        tally = sweep(
            study,
            folder,
            workers=options.workers,
            scheduler=options.scheduler,
            retry_failed=options.retry_failed,
        )
        summary = summarize(folder, tally)
        print(as_text(summary))
        names = ["runs.csv", "summary.json", *(f"{path.stem}.png and .svg" for path in draw_figures(folder))]
    except KeyboardInterrupt as interrupt:
        print(f"\nndob-fmu: interrupted; finished runs are in {folder}, the same command goes on", file=sys.stderr)
        return exit_code(interrupt)
    print(f"Look at {folder}: {', '.join(names)}; `ndob-fmu report {folder}` makes a page of it.")
    return 0 if summary["failed"] == 0 else 1


def _report(options: argparse.Namespace) -> int:
    with extra("report"):
        from ndob_fmu.report import write_report

    print(write_report(options.results, options.out))
    return 0
