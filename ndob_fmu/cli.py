"""The command line `ndob-fmu`: each command is one function that calls the package and prints what came of it."""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any, NoReturn

from ndob_fmu import __version__
from ndob_fmu.errors import NdobError, UsageError
from ndob_fmu.support.extras import extra
from ndob_fmu.support.interrupts import exit_code, interruptible, received
from ndob_fmu.support.progress import PATIENCE, begin, shown_after
from ndob_fmu.support.temporary import remove_folders

_BUILD = Path("build")
_DEMO_MODEL = "flexible_joint"
_DEMO_SYSTEM = "open_loop"
_READER_GONE = 128 + 13  # SIGPIPE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 where a check or a run failed, 2 where the input is unusable.

    Where a signal ended it, that is 128 and the number of the signal.
    """
    with interruptible(terminate=True):
        try:
            return _run(arguments)
        finally:
            remove_folders()


def _run(arguments: Sequence[str] | None) -> int:
    options = _parser().parse_args(arguments)
    logging.basicConfig(format="ndob-fmu: %(message)s", level=logging.WARNING)
    try:
        with shown_after(PATIENCE) if options.run in (_check, _design, _build) else nullcontext():
            code: int = options.run(options)
    except (Exception, KeyboardInterrupt) as error:
        interrupt = error if isinstance(error, KeyboardInterrupt) else received()
        if interrupt is not None:
            print("ndob-fmu: interrupted; no unfinished file is left", file=sys.stderr)
            return exit_code(interrupt)
        if not isinstance(error, NdobError):
            raise
        print(f"ndob-fmu: {error}", file=sys.stderr)
        return error.exit_code
    return code


def run_and_leave() -> NoReturn:
    """Run one command and end the process with its exit code; 141, as a shell has it, where the reader has gone.

    Without Python's own end: the static state of pythonfmu's binary, loaded with an FMU, is used then after being freed
    and may abort the process although all went well. Every file is closed by now.
    """
    with interruptible(terminate=True):  # to the very end: a second Ctrl-C must not print a traceback
        try:
            code = _code_of_main()
        except KeyboardInterrupt as interrupt:  # before or after the command itself
            code = exit_code(interrupt)
        os._exit(code)


def _code_of_main() -> int:
    try:
        code = main()
        sys.stdout.flush()
    except SystemExit as end:  # argparse's --help, --version and usage errors
        code = end.code if isinstance(end.code, int) else 0
        with suppress(OSError):
            sys.stdout.flush()
    except BrokenPipeError:  # as in `ndob-fmu check … | head -1`
        code = _READER_GONE
    except OSError as error:
        if error.filename is not None:  # of a file, and not of the stream that is printed to
            raise
        code = 2
        with suppress(OSError):
            print(f"ndob-fmu: the output cannot be written: {error.strerror}", file=sys.stderr)
    with suppress(OSError):
        sys.stderr.flush()
    return code


def _check(options: argparse.Namespace) -> int:
    if options.model.endswith(".ssp"):
        return _check_system(options)
    if options.picture is not None:
        raise UsageError.report("--picture", expected="a system (.ssp) to draw", received=options.model)
    from ndob_fmu.analysis.assumptions import check
    from ndob_fmu.model.loading import load_model

    report = check(load_model(options.model))
    print(_json(report.to_dict()) if options.json else report)
    return 0 if report.passed else 1


def _check_system(options: argparse.Namespace) -> int:
    from ndob_fmu.cosim import check_ssp

    begin(f"reading {options.model} and its FMUs")
    report = check_ssp(options.model, strict=options.strict, picture=options.picture)
    print(report.to_json() if options.json else report)
    return 0 if report.passed else 1


def _design(options: argparse.Namespace) -> int:
    from ndob_fmu.analysis.design import design
    from ndob_fmu.model.loading import load_model

    result = design(
        load_model(options.model),
        pi=options.pi,
        alpha=options.alpha,
        step_size=options.step_size,
        disturbance_order=options.disturbance_order,
        noise_std=options.noise_std,
        disturbance_bound=options.disturbance_bound,
        disturbance_rate=options.disturbance_rate,
    )
    print(_json(result.to_dict()) if options.json else result)
    return 0


def _build(options: argparse.Namespace) -> int:
    for path in _build_all(options.model, options.out, options.components, options.systems):
        print(path)
    return 0


def _build_all(name: str, out: Path, components: bool, systems: Path | None) -> Iterator[Path]:
    """Build one after the other and yield their paths; the FMUs that no design can fail for come first."""
    from ndob_fmu.cosim import parameter_sets
    from ndob_fmu.fmu import build
    from ndob_fmu.fmu.components import build_components, build_controller
    from ndob_fmu.model.loading import load_model
    from ndob_fmu.packages import build_ssp
    from ndob_fmu.support.shipped import shipped_folder

    model = load_model(name)
    yield from build(model, out)
    if components or systems is not None:
        yield from build_components(out)
        yield build_controller(model, out)
    if systems is not None:
        for folder in sorted(path.parent for path in shipped_folder("ssp").glob("*/SystemStructure.ssd")):
            for one in (None, *parameter_sets(folder)):
                yield build_ssp(folder, out, systems, parameter_set=one)


def _build_demo() -> Path:
    deque(_build_all(_DEMO_MODEL, _BUILD / "fmus", True, _BUILD / "ssp"), maxlen=0)
    return _BUILD / "ssp" / f"{_DEMO_SYSTEM}.ssp"


def _simulate(options: argparse.Namespace) -> int:
    from ndob_fmu.cosim import simulate
    from ndob_fmu.cosim.run_folder import simulate_into
    from ndob_fmu.results.csv_files import write_csv
    from ndob_fmu.results.recording import FailedRunError

    if options.demo == (options.system is not None):
        raise UsageError.report(
            "simulate", expected="either the path of a system or --demo", received="both" if options.demo else "neither"
        )
    settings = {
        "start_time": options.start_time,
        "stop_time": options.stop_time,
        "step_size": options.step_size,
        "output_interval": options.output_interval,
        "start_values": _pairs(options.start_values),
        "input_file": options.input_file,
        "tolerance": options.tolerance,
        "strict": options.strict,
        "scheme": options.scheme,
        "order": options.order,
    }
    system = _build_demo() if options.demo else options.system
    failure: FailedRunError | None = None
    try:
        if options.results is None:
            recording = simulate(system, **settings)
        else:
            recording = simulate_into(options.results, system, **settings)
    except FailedRunError as error:
        if error.recording is None:
            raise
        recording, failure = error.recording, error
    span = f"{recording.time[0]:g} to {recording.time[-1]:g} s"
    rows = f"{len(recording.time)} rows of {len(recording.names)} signals, {span}"
    if failure is not None:
        rows += ", as far as the simulation came"
    if options.output_file is not None:
        write_csv(options.output_file, recording)
        print(f"{options.output_file}: {rows}")
    elif options.results is not None:
        print(f"{options.results}: {rows}; `ndob-fmu report {options.results}` makes a page of them")
    else:
        print(f"{rows}; --output-file FILE or --results DIR keeps them")
    if options.show_plot:
        from ndob_fmu.results import plots

        plots.show(recording)
    if failure is not None:
        raise failure
    return 0


def _sweep(options: argparse.Namespace) -> int:
    with extra("study"):
        from ndob_fmu.study import read_study, sweep
        from ndob_fmu.study.figures import draw
        from ndob_fmu.study.summary import as_text, summarize

    study = read_study(options.study)
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
        names = ["runs.csv", "summary.json", *(f"{path.stem}.png and .svg" for path in draw(folder))]
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


def _demo(options: argparse.Namespace) -> int:
    from ndob_fmu.demo import run_demo

    summary = run_demo(_build_demo(), options.out)
    settled = summary["settling_time_2_percent"]
    late = summary["max_disturbance_error_from_12_s"]
    print(
        f"The paper's example, two FMUs coupled every {summary['step_size']:g} s for {summary['stop_time']:g} s:\n"
        f"  estimate within 2 % of the disturbance from {settled:.2f} s on; largest error from 12 s on {late:.4f} N·m\n"
        f"  state error at the end {summary['final_state_error']:.2e}; "
        f"largest estimate {summary['peak_estimate']:.3g} N·m "
        f"(without the schedule {summary['peak_estimate_without_schedule']:.3g})\n"
        f"  the sampled-data design (method 2) on the same FMUs: within 2 % from "
        f"{summary['sampled_data']['settling_time_2_percent']:.3f} s on, then "
        f"{summary['sampled_data']['final_disturbance_error']:.0e} N·m\n"
        f"Look at {options.out}: fig1_disturbance.png, fig2_state_error.png, fig3_peaking.png, fig4_start_up.png,\n"
        f"result.csv and summary.json."
    )
    return 0


def _pairs(words: Sequence[str]) -> dict[str, str]:
    """Return NAME VALUE … as a mapping; `simulate` reads each value by the variable's type."""
    if len(words) % 2:
        raise UsageError.report(
            "--start-values", expected="pairs NAME VALUE", received=f"{len(words)} words", likely="a value is missing"
        )
    return dict(zip(words[::2], words[1::2], strict=True))


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise ValueError
    return number


_positive.__name__ = "whole number of 1 or more"  # what argparse calls it


def _json(data: Any) -> str:
    return json.dumps(data, indent=2)


def _parser() -> argparse.ArgumentParser:
    # argparse and not a richer library: --start-values takes any number of words, as in `fmpy simulate`.
    parser = argparse.ArgumentParser(
        prog="ndob-fmu", description="Nonlinear disturbance observer: check, design, build and simulate it as FMUs."
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Any, text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(run=run)
        return sub

    model_help = f"a Python file that defines `model`, or a built-in name ({_DEMO_MODEL})"

    sub = command("check", _check, "Check the paper's assumptions on a model, or a system; exit code 1 if one fails.")
    sub.add_argument("model", metavar="MODEL", help=f"{model_help}, or the path of a system (.ssp)")
    sub.add_argument("--strict", action="store_true", help="fail for inputs of a system that nothing drives")
    sub.add_argument("--picture", type=Path, metavar="FILE", help="also draw the system (.svg)")
    sub.add_argument("--json", action="store_true", help="print JSON")

    sub = command("design", _design, "Design the observer: gains, poles, bandwidth, noise gain.")
    sub.add_argument("model", metavar="MODEL", help=model_help)
    sub.add_argument("--pi", type=float, help="design parameter of the Riccati equation (default: the model's pi_end)")
    sub.add_argument("--alpha", type=float, help="prescribed stability in 1/s (default: the model's)")
    sub.add_argument(
        "--step-size", type=float, metavar="H", help="also design the sampled-data observer for a step of H s"
    )
    sub.add_argument(
        "--disturbance-order", type=int, choices=range(4), help="derivatives of the disturbance that it carries"
    )
    sub.add_argument("--noise-std", type=float, metavar="S", help="standard deviation of the noise in a sample")
    for option, text in (("bound", "bound of |d|"), ("rate", "bound of the r-th derivative of d")):
        sub.add_argument(
            f"--disturbance-{option}", type=float, nargs="+", metavar="D", help=f"{text}, one for each disturbance"
        )
    sub.add_argument("--json", action="store_true", help="print JSON")

    sub = command("build", _build, "Build <Name>Plant.fmu and <Name>Observer.fmu.")
    sub.add_argument("model", metavar="MODEL", help=model_help)
    sub.add_argument(
        "--out", type=Path, default=_BUILD / "fmus", metavar="DIR", help="folder of the FMUs (%(default)s)"
    )
    sub.add_argument(
        "--components",
        action="store_true",
        help="also <Name>Controller.fmu, DisturbanceSource.fmu, Encoder.fmu and TorsionSpring.fmu",
    )
    sub.add_argument(
        "--systems", type=Path, metavar="DIR", help="also these, and the shipped systems with all of them into DIR"
    )

    sub = command("simulate", _simulate, "Co-simulate a system (.ssp) or one FMU at a fixed communication step.")
    sub.add_argument("system", nargs="?", metavar="SYSTEM", help="path of an .ssp or .fmu")
    sub.add_argument("--demo", action="store_true", help="build and run the paper's example")
    for option, text in (
        ("--start-time", "start time in s"),
        ("--stop-time", "stop time in s"),
        ("--step-size", "communication step in s"),
        ("--output-interval", "time between recorded rows in s, a whole multiple of the step"),
    ):
        sub.add_argument(option, type=float, help=f"{text} (default: the system's)")
    sub.add_argument("--tolerance", type=float, help="relative tolerance inside the FMUs (default: that of each FMU)")
    sub.add_argument(
        "--start-values", nargs="+", default=[], metavar="NAME VALUE", help="start values by component.variable"
    )
    sub.add_argument("--strict", action="store_true", help="refuse inputs that nothing drives, instead of a warning")
    sub.add_argument("--input-file", type=Path, help="CSV of inputs, columns component.variable")
    sub.add_argument("--output-file", type=Path, help="CSV to write")
    sub.add_argument("--results", type=Path, metavar="DIR", help="folder for CSV, summary and figures (PNG and SVG)")
    sub.add_argument(
        "--scheme", choices=["jacobi", "gauss-seidel", "extrapolation"], default="jacobi", help="coupling (%(default)s)"
    )
    sub.add_argument(
        "--order", nargs="+", metavar="COMPONENT", help="order of gauss-seidel (default: that of the system)"
    )
    sub.add_argument("--show-plot", action="store_true", help="open a window with the signals")

    sub = command("sweep", _sweep, "Do a parameter study on many workers; goes on where an earlier call was stopped.")
    sub.add_argument("study", type=Path, metavar="STUDY.toml", help="what to run and to vary: docs/studies.md")
    sub.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (default: results/NAME OF STUDY)")
    sub.add_argument("--workers", type=_positive, metavar="N", help="processes on this machine (default: one per core)")
    sub.add_argument("--scheduler", metavar="ADDRESS", help="a running dask scheduler instead, as tcp://HOST:8786")
    sub.add_argument("--retry-failed", action="store_true", help="do the failed runs again")

    sub = command("report", _report, "Make one HTML page, which works offline, of the results of a run or a study.")
    sub.add_argument("results", type=Path, metavar="RESULTS_DIR", help="folder of a run, of the demo or of a study")
    sub.add_argument("--out", type=Path, metavar="FILE", help="page to write (default: RESULTS_DIR/report.html)")

    sub = command("demo", _demo, "Run the paper's example and write its figures.")
    sub.add_argument(
        "--out",
        type=Path,
        default=Path("results", _DEMO_MODEL),
        metavar="DIR",
        help="folder of the results (%(default)s)",
    )
    return parser
