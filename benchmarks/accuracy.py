"""The accuracy of this package's observer and of what could be used in its place, on one plant, in one table.

    python -m benchmarks.accuracy [--quick] [--must-show [--rows PATTERN | --models PATH …]] [--out DIR] [--seed N]
                                  [--workers N]

The script runs every estimator on the paper's flexible joint over step sizes, disturbances and noise, and then on the
plants of `benchmarks/estimator` with faulty samples and half-true statements. It writes `accuracy.md` and its figures
into DIR, by default `docs`. --must-show prints the figures that the observer is required to reach; with --rows only
those on several plants whose name contains a regular expression, with --models those of your own model files beside an
extended Kalman filter (`benchmarks/estimator/model_files.py`). The same arguments write the same bytes, however many
workers there are.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.accuracy_cells import QUICK, Plan, in_parallel, run_all
from benchmarks.accuracy_must_show import as_text, measure
from benchmarks.accuracy_page import write
from benchmarks.estimator import figures, must_show, page

RECORDS = 3  # of every cell on the plants of `benchmarks/estimator`


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0], prog="python -m benchmarks.accuracy")
    parser.add_argument("--quick", action="store_true", help="a few cells only, as a smoke test")
    parser.add_argument(
        "--must-show", action="store_true", help="only print the required figures and the measured ones"
    )
    parser.add_argument("--rows", metavar="PATTERN", help="of --must-show: only the estimator's rows of such a name")
    parser.add_argument("--models", metavar="PATH", nargs="+", help="of --must-show: only those of these model files")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs", help="default: docs")
    parser.add_argument("--seed", type=int, default=Plan.seed, help="of the measurement noise")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args(arguments)
    plan = replace(QUICK if given.quick else Plan(), seed=given.seed)
    if given.must_show:
        seeds = range(given.seed, given.seed + RECORDS)
        if given.models:
            print(figures.as_text(must_show.measured_models(given.models, seeds, in_parallel, given.workers)))
            return 0
        if given.rows is None:
            print(as_text(measure(plan, given.workers)), end="\n\n")
        print(figures.as_text(must_show.measured(given.rows or "", seeds, in_parallel, given.workers)))
        return 0
    required = measure(plan, given.workers)
    if given.quick:
        plants = page.run_all([given.seed], in_parallel, given.workers, few=1, plants="joint")
    else:
        plants = page.run_all(range(given.seed, given.seed + RECORDS), in_parallel, given.workers)
    for path in write(given.out, plan, run_all(plan, given.workers), required, plants):
        print(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
