"""The commands that start from a recorded log: estimate."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ndob_fmu.command_line.options import MODEL_HELP, Commands, add_command, assignments, pairs

if TYPE_CHECKING:
    from ndob_fmu.log.estimate_log import Estimated


def add_log_commands(commands: Commands) -> None:
    """Add estimate."""
    parser = add_command(
        commands,
        "estimate",
        _estimate,
        "Run a model's observer over a recorded log: estimates with error bars, and what the residuals say.",
        slow=True,
    )
    parser.add_argument("model", metavar="MODEL", help=MODEL_HELP)
    parser.add_argument("log", metavar="LOG", type=Path, help="CSV or Parquet file with time, inputs and outputs")
    parser.add_argument(
        "--map",
        nargs="+",
        default=[],
        metavar="COLUMN=NAME",
        help="the model's names of columns that have others; time too",
    )
    parser.add_argument(
        "--unit",
        nargs="+",
        default=[],
        metavar="COLUMN=UNIT",
        help="units of columns that are not in the model's: deg, mm, ms",
    )
    parser.add_argument(
        "--start-values", nargs="+", default=[], metavar="NAME VALUE", help="values of the observer's parameters"
    )
    parser.add_argument("--start-values-file", type=Path, metavar="FILE", help="JSON file of such values")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of result.csv, summary.json and figures (default: results/LOG)"
    )


def _estimate(options: argparse.Namespace) -> int:
    from ndob_fmu.log.estimate_log import estimate_log
    from ndob_fmu.log.told_values import read_start_values
    from ndob_fmu.model.loading import load_model

    given = {} if options.start_values_file is None else read_start_values(options.start_values_file)
    out = options.out or Path("results", options.log.stem)
    estimated = estimate_log(
        load_model(options.model),
        options.log,
        out,
        names=assignments("--map", options.map),
        units=assignments("--unit", options.unit),
        start_values={**given, **pairs("--start-values", options.start_values)},
    )
    print(_text(estimated))
    print(f"{out}: result.csv, summary.json and figures; `ndob-fmu report {out}` makes a page of them")
    return 0


def _text(found: Estimated) -> str:
    rows = found.found
    lines = [
        f"{rows.rows} rows, {found.start_time:.6g} to {found.stop_time:.6g} s, usual step {found.step:.4g} s, "
        f"jitter {100.0 * found.jitter:.2g} %",
        f"  {found.gaps} gaps, {rows.merged} rows of a time that was there before, {rows.missing_samples} samples and "
        f"{rows.missing_inputs} inputs missing",
        f"  estimate valid in {100.0 * found.valid:.1f} % of the rows"
        + ("" if found.jumps is None else f"; the smoother found {found.jumps} jumps and {found.outliers} outliers"),
    ]
    for name, output in found.diagnoses.items():
        lines.append(
            f"  {name}: residuals² {output.size:.3g} × their variance (1 ± {output.size_band:.2g}), correlation "
            f"{output.correlation[0]:.2f} (0 ± {output.correlation_band:.2g}), {100.0 * output.refused:.2g} % refused"
        )
    lines += [f"warning: {line}" for line in found.warnings]
    lines += [f"verdict: {line}" for line in found.verdicts] or ["verdict: the settings fit the log"]
    return "\n".join(lines)
