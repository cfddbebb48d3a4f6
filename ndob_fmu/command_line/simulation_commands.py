"""The commands that run coupled FMUs once: simulate, demo."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from ndob_fmu.command_line.model_commands import build_demo, build_native_demo
from ndob_fmu.command_line.options import DEMO_MODEL, NATIVE, Commands, add_command, pairs
from ndob_fmu.errors import UsageError


def add_simulation_commands(commands: Commands) -> None:
    """Add simulate and demo."""
    parser = add_command(
        commands, "simulate", _simulate, "Co-simulate a system (.ssp) or one FMU at a fixed communication step."
    )
    parser.add_argument("system", nargs="?", metavar="SYSTEM", help="path of an .ssp or .fmu")
    parser.add_argument("--demo", action="store_true", help="build and run the paper's example")
    for option, text in (
        ("--start-time", "start time in s"),
        ("--stop-time", "stop time in s"),
        ("--step-size", "communication step in s"),
        ("--output-interval", "time between recorded rows in s, a whole multiple of the step"),
    ):
        parser.add_argument(option, type=float, help=f"{text} (default: the system's)")
    parser.add_argument("--tolerance", type=float, help="relative tolerance of the FMUs (default: each FMU's own)")
    parser.add_argument(
        "--start-values", nargs="+", default=[], metavar="NAME VALUE", help="start values by component.variable"
    )
    parser.add_argument(
        "--start-values-file",
        type=Path,
        metavar="FILE",
        help="JSON file of such values, as `fit` writes it; a parameter's name alone is for each component that has it",
    )
    parser.add_argument("--strict", action="store_true", help="refuse inputs that nothing drives, instead of a warning")
    parser.add_argument("--input-file", type=Path, help="CSV of inputs, columns component.variable")
    parser.add_argument("--output-file", type=Path, help="CSV file of the results")
    parser.add_argument("--results", type=Path, metavar="DIR", help="folder for CSV, summary and figures (PNG and SVG)")
    parser.add_argument(
        "--scheme", choices=["jacobi", "gauss-seidel", "extrapolation"], default="jacobi", help="coupling (%(default)s)"
    )
    parser.add_argument(
        "--order", nargs="+", metavar="COMPONENT", help="order of gauss-seidel (default: that of the system)"
    )
    parser.add_argument("--show-plot", action="store_true", help="show the signals in a window")

    parser = add_command(commands, "demo", _demo, "Run the paper's example and write its figures.")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results", DEMO_MODEL),
        metavar="DIR",
        help="folder of the results (%(default)s)",
    )


def _simulate(options: argparse.Namespace) -> int:
    from ndob_fmu.cosim import simulate
    from ndob_fmu.cosim.run_folder import simulate_into
    from ndob_fmu.results.csv_files import write_csv
    from ndob_fmu.results.recording import FailedRunError

    if options.demo == (options.system is not None):
        raise UsageError.report(
            "simulate", expected="either the path of a system or --demo", received="both" if options.demo else "neither"
        )
    system = build_demo() if options.demo else options.system
    settings = {
        "start_time": options.start_time,
        "stop_time": options.stop_time,
        "step_size": options.step_size,
        "output_interval": options.output_interval,
        "start_values": {
            **_of_file(system, options.start_values_file),
            **pairs("--start-values", options.start_values),
        },
        "input_file": options.input_file,
        "tolerance": options.tolerance,
        "strict": options.strict,
        "scheme": options.scheme,
        "order": options.order,
    }
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


def _of_file(system: Path | str, file: Path | None) -> dict[str, Any]:
    if file is None:
        return {}
    from ndob_fmu.cosim import start_values_of_components
    from ndob_fmu.log.told_values import read_start_values

    return start_values_of_components(system, read_start_values(file))


def _demo(options: argparse.Namespace) -> int:
    from ndob_fmu.demo import run_demo

    system = build_demo()
    with ThreadPoolExecutor(1) as compiler:  # it compiles while the FMUs in Python run
        native = compiler.submit(build_native_demo, NATIVE.absolute())
        summary = run_demo(system, options.out, native=native.result)
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
        f"{_builds_compared(summary['native'])}\n"
        f"Look at {options.out}: fig1_disturbance.png, fig2_state_error.png, fig3_peaking.png, fig4_start_up.png,\n"
        f"result.csv and summary.json."
    )
    return 0


def _builds_compared(native: Mapping[str, Any]) -> str:
    """Return a line on the demo with native FMUs."""
    if "not_built" in native:
        return f"  not compared with native FMUs: {native['not_built']}"
    paper, sampled = native["paper"], native["sampled_data"]
    seconds = [f"{run['native_seconds']:.2g} s instead of {run['python_seconds']:.2g} s" for run in (paper, sampled)]
    return (
        f"  the same system of native FMUs ({NATIVE}): {seconds[0]}, with method 2 {seconds[1]}; "
        f"signals differ by at most {max(paper['difference'], sampled['difference']):.0e} of their size"
    )
