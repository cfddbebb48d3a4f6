"""The commands that start from a recorded log: estimate, fit, tune."""

from __future__ import annotations

import argparse
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ndob_fmu.command_line.options import MODEL_HELP, NATIVE, Commands, add_command, assignments, command_text, pairs
from ndob_fmu.support.extras import extra
from ndob_fmu.support.progress import PATIENCE, shown_after

if TYPE_CHECKING:
    from ndob_fmu.log.estimate_log import Estimated
    from ndob_fmu.log.fit.fit_log import Fitted
    from ndob_fmu.log.told import Told
_FITS = (
    "the settings fit the log; a wrong parameter that acts as the disturbance does is a part of its estimate and does "
    "not show here: `ndob-fmu fit --free` tells of it"
)


def add_log_commands(commands: Commands) -> None:
    """Add estimate, fit and tune."""
    estimate = add_command(
        commands,
        "estimate",
        _estimate,
        "Run a model's observer over a recorded log: estimates with error bars, and what the residuals say.",
        slow=True,
    )
    _add_log(estimate)
    estimate.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of result.csv, summary.json and figures (default: results/LOG)"
    )
    fit = add_command(
        commands,
        "fit",
        _fit,
        "Find a model's noise, the class and pace of its disturbance, and named parameters in a recorded log.",
        slow=True,
    )
    _add_log(fit)
    fit.add_argument(
        "--free",
        nargs="+",
        default=[],
        metavar="PARAMETER",
        help="parameters of the model to be fitted; OUTPUT_bias: a constant offset of that output",
    )
    fit.add_argument(
        "--hold",
        type=float,
        default=0.3,
        metavar="SHARE",
        help="share of the rows, the last ones, to judge by (default: %(default)s)",
    )
    fit.add_argument("--out", type=Path, metavar="DIR", help="folder of fit.json (default: results/LOG)")
    tune = add_command(
        commands,
        "tune",
        _tune,
        "Open a local page with sliders for the settings, which shows at once what they make of a recorded log.",
    )
    _add_log(tune)
    tune.add_argument("--out", type=Path, metavar="DIR", help="folder to save fit.json into (default: results/LOG)")
    tune.add_argument("--no-browser", action="store_true", help="print the address only")


def _add_log(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a command for a model and a log."""
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


def _told(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of a log that its commands share."""
    from ndob_fmu.log.told_values import read_start_values

    given = {} if options.start_values_file is None else read_start_values(options.start_values_file)
    return {
        "names": assignments("--map", options.map),
        "units": assignments("--unit", options.unit),
        "start_values": {**given, **pairs("--start-values", options.start_values)},
    }


def _fit(options: argparse.Namespace) -> int:
    from ndob_fmu.log.fit.fit_log import FIT, fit_log
    from ndob_fmu.model.loading import load_model

    out = options.out or Path("results", options.log.stem)
    model = load_model(options.model)
    native, told = NATIVE / "fmus", _told(options)
    fitted = fit_log(model, options.log, out, free=options.free, hold=options.hold, native=native, **told)
    print(_fit_text(fitted, model.units))
    path = out / FIT
    print(f"{path}: `{_estimate_with(options, path)}` uses it")
    return 0


def _estimate_with(options: argparse.Namespace, start_values: Path) -> str:
    """Return the command that estimates with start values along the log of another command."""
    words = ["ndob-fmu", "estimate", options.model, str(options.log)]
    for option, given in (("--map", options.map), ("--unit", options.unit)):
        words += [option, *given] if given else []
    return command_text([*words, "--start-values-file", str(start_values)])


def _tune(options: argparse.Namespace) -> int:
    with extra("tune"):
        from ndob_fmu.log.tune.serve import address, page_server
    from ndob_fmu.log.tune.workbench import Workbench
    from ndob_fmu.model.loading import load_model

    with shown_after(PATIENCE):
        workbench = Workbench(load_model(options.model), options.log, native=NATIVE / "fmus", **_told(options))
    for line in workbench.warnings:
        print(f"warning: {line}", flush=True)
    server = page_server(workbench, options.log.name, options.out or Path("results", options.log.stem))
    print(f"{address(server)}: settings for {options.log}; Ctrl-C ends it", flush=True)
    if not options.no_browser:
        webbrowser.open(address(server))
    server.serve_forever()
    return 0


def _fit_text(found: Fitted, units: Mapping[str, str]) -> str:
    """Return what was found, and how sure it is."""
    from ndob_fmu.log.fit.fit_log import FIT

    def each(told: Mapping[str, Told]) -> str:
        return ", ".join(
            f"{name} {one.value:.4g} ± {2.0 * one.std:.2g} {units.get(name.removesuffix('_bias'), '')}".rstrip()
            for name, one in told.items()
        )

    kinds = {name: {1: "wanders", 2: "is smooth"}[order] for name, order in found.orders.items()}
    is_one = len(set(kinds.values())) == 1
    kind = f"the disturbance {kinds.popitem()[1]}" if is_one else ", ".join(map(" ".join, kinds.items()))
    own = "" if is_one else f"; disturbance_own_order {', '.join(f'{d} {r}' for d, r in found.orders.items())}"
    jumps = f" and jumps ({found.jumps} times in {found.rows} rows)" if found.is_jumping else ""
    held = found.held_out_values
    judged = ", ".join(f"order {order} {value:.4f}" for order, value in held.items() if value is not None)
    if judged and not is_one:
        judged += f", these orders {found.held_out_value:.4f}"
    lines = [
        f"{found.rows} rows, along which the {found.build} observer ran",
        f"noise_std: {each(found.noise_std)}; {found.outliers} outliers",
        f"{kind}{jumps}: disturbance_order {found.order}{own}; log-likelihood of a sample of the "
        + (f"{found.held_out} held-out rows: {judged}" if judged else "rows; none was held out"),
        f"parameters: {each(found.parameters) or 'none fitted'}",
        f"± is two standard deviations; an entry <name>_std of {FIT} is one",
        *(
            f"map of {name}: {' and '.join(one.depends_on)} explain {100.0 * one.explained:.0f} % of its mean square; "
            f"{one.rms_with:.3g} RMS of {one.rms_without:.3g} remain in parts of the log that were left out"
            for name, one in found.maps.items()
        ),
    ]
    return "\n".join([*lines, *(f"warning: {line}" for line in found.warnings)])


def _estimate(options: argparse.Namespace) -> int:
    from ndob_fmu.log.estimate_log import estimate_log
    from ndob_fmu.model.loading import load_model

    out = options.out or Path("results", options.log.stem)
    model = load_model(options.model)
    estimated = estimate_log(model, options.log, out, native=NATIVE / "fmus", **_told(options))
    print(_text(estimated, model.units))
    report = command_text(["ndob-fmu", "report", str(out)])
    print(f"{out}: result.csv, summary.json and figures; `{report}` makes a page of them")
    return 0


def _text(found: Estimated, units: Mapping[str, str]) -> str:
    rows, shown = found.found, found.shown_time
    start, stop = found.start_time - shown.zero, found.stop_time - shown.zero
    lines = [
        f"{rows.rows} rows, {start:.6g} to {stop:.6g} s{f' ({shown.text})' if shown.text else ''}, usual step "
        f"{found.step:.4g} s, jitter {100.0 * found.jitter:.2g} %",
        f"  {found.gaps} gaps, {rows.merged} rows of a time that was there before, {rows.missing_samples} samples and "
        f"{rows.missing_inputs} inputs missing",
        f"  estimate of the {found.build} observer, valid in {100.0 * found.valid:.1f} % of the rows"
        + ("" if found.jumps is None else f"; the smoother found {found.jumps} jumps and {found.outliers} outliers"),
    ]
    lines += [
        f"  {name}: offset {one.value:.4g} ± {2.0 * one.std:.2g} {units.get(name, '')}".rstrip()
        for name, one in found.offsets.items()
    ]
    for name, output in found.diagnoses.items():
        lines.append(
            f"  {name}: residuals² {output.size:.3g} × their variance (1 ± {output.size_band:.2g}), correlation "
            f"{output.correlation[0]:.2f} (0 ± {output.correlation_band:.2g}), {100.0 * output.refused:.2g} % refused"
        )
    lines += [f"warning: {line}" for line in found.warnings]
    lines += [f"verdict: {line}" for line in found.verdicts] or [f"verdict: {_FITS}"]
    return "\n".join(lines)
