"""The commands that start from a model: check, design, build."""

from __future__ import annotations

import argparse
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ndob_fmu.command_line.options import (
    BUILD,
    DEMO_MODEL,
    MODEL_HELP,
    NATIVE,
    Commands,
    add_command,
    as_json,
    number_or_pairs,
)
from ndob_fmu.errors import UsageError, one_of
from ndob_fmu.support.progress import begin

if TYPE_CHECKING:
    from ndob_fmu.model.model import Model

_DEMO_SYSTEM = "open_loop"


def add_model_commands(commands: Commands) -> None:
    """Add check, design and build."""
    parser = add_command(
        commands,
        "check",
        _check,
        "Check what each method needs of a model, or check a system; exit code 1 if the default method lacks it.",
        slow=True,
    )
    parser.add_argument("model", metavar="MODEL", help=f"{MODEL_HELP}, or the path of a system (.ssp)")
    parser.add_argument(
        "--strict", action="store_true", help="of a system: let inputs that nothing drives fail the check"
    )
    parser.add_argument("--picture", type=Path, metavar="FILE", help="also draw the system (.svg)")
    parser.add_argument("--json", action="store_true", help="print JSON")

    parser = add_command(
        commands, "design", _design, "Design the observer: gains, poles, bandwidth, noise gain.", slow=True
    )
    parser.add_argument("model", metavar="MODEL", help=MODEL_HELP)
    parser.add_argument(
        "--pi", type=float, help="design parameter of the Riccati equation (default: the model's pi_end)"
    )
    parser.add_argument("--alpha", type=float, help="prescribed stability in 1/s (default: the model's)")
    parser.add_argument(
        "--step-size", type=float, metavar="H", help="also design the sampled-data observer for a step of H s"
    )
    parser.add_argument(
        "--disturbance-order",
        type=int,
        choices=range(4),
        help="order r of the disturbance model: d and r - 1 derivatives are estimated",
    )
    parser.add_argument(
        "--noise-std",
        nargs="+",
        metavar="OUTPUT S",
        help="standard deviation of the noise in a sample of an output; one number S alone is for all outputs",
    )
    for option, text in (("bound", "bound of |d|"), ("rate", "bound of the r-th derivative of d")):
        parser.add_argument(
            f"--disturbance-{option}",
            type=float,
            nargs="+",
            metavar="D",
            help=f"{text}, one value for each disturbance",
        )
    parser.add_argument("--json", action="store_true", help="print JSON")

    parser = add_command(
        commands,
        "build",
        _build,
        "Build <Name>Plant.fmu and <Name>Observer.fmu; without a MODEL the component FMUs that fit any plant.",
        slow=True,
    )
    parser.add_argument("model", metavar="MODEL", nargs="?", help=MODEL_HELP)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder of the FMUs (default: {BUILD / 'fmus'}, of native ones {NATIVE / 'fmus'})",
    )
    parser.add_argument(
        "--components",
        action="store_true",
        help="also <Name>Controller.fmu and the component FMUs, which docs/systems.md lists",
    )
    parser.add_argument(
        "--systems", type=Path, metavar="DIR", help="also these, and packages of the shipped systems in DIR"
    )
    parser.add_argument(
        "--start-values-file",
        type=Path,
        metavar="FILE",
        help="JSON file of start values of parameters, as `fit` writes it; each FMU takes those that it has",
    )
    parser.add_argument(
        "--target",
        choices=("python", "native"),
        default="python",
        help="native: FMUs in C, with their sources, that need no Python where they run (%(default)s)",
    )
    parser.add_argument(
        "--platforms",
        nargs="+",
        choices=("linux64", "win64", "darwin64", "aarch64-linux"),
        default=[],
        metavar="NAME",
        help="of native FMUs: linux64, win64, darwin64, aarch64-linux; others than this machine's need zig's compiler, "
        "pip install 'ndob-fmu[native]' (default: this machine's)",
    )
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="version of FMI, 3 for native FMUs only")


def _check(options: argparse.Namespace) -> int:
    if options.model.endswith(".ssp"):
        return _check_system(options)
    if options.picture is not None:
        raise UsageError.report("--picture", expected="a system (.ssp) to draw", received=options.model)
    from ndob_fmu.analysis.assumptions import check
    from ndob_fmu.model.loading import load_model

    report = check(load_model(options.model))
    print(as_json(report.to_dict()) if options.json else report)
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
        noise_std=number_or_pairs("--noise-std", options.noise_std),
        disturbance_bound=options.disturbance_bound,
        disturbance_rate=options.disturbance_rate,
    )
    print(as_json(result.to_dict()) if options.json else result)
    return 0


def _build(options: argparse.Namespace) -> int:
    native = options.target == "native"
    if not native and (options.platforms or options.fmi != 2):
        given = "--platforms" if options.platforms else "--fmi 3"
        raise UsageError.report(f"build {given}", expected="--target native", received="--target python")
    if options.systems is not None and options.fmi != 2:
        raise UsageError.report("build --systems", expected="--fmi 2, whose FMUs are coupled", received="--fmi 3")
    out = options.out or (NATIVE if native else BUILD) / "fmus"
    values = _start_values(options)
    builders = _native_builders(options.platforms, options.fmi, values) if native else _python_builders(values)
    for path in _build_all(options.model, out, options.components, options.systems, builders):
        print(path)
    return 0


def _start_values(options: argparse.Namespace) -> dict[str, Any]:
    if options.start_values_file is None:
        return {}
    if options.model is None:
        raise UsageError.report("build --start-values-file", expected="the MODEL that they are of", received="none")
    from ndob_fmu.log.told_values import read_start_values

    return read_start_values(options.start_values_file)


class _Builders(NamedTuple):
    """How the FMUs of a target are built into a folder."""

    plant_and_observer: Callable[[Model, Path], Iterable[Path]]
    components: Callable[[Path], Iterable[Path]]
    controller: Callable[[Model, Path], Path]


def _python_builders(start_values: Mapping[str, Any] | None = None) -> _Builders:
    from ndob_fmu.fmu import build
    from ndob_fmu.fmu.components import build_components
    from ndob_fmu.fmu.controller import build_controller

    return _Builders(partial(build, start_values=start_values), build_components, build_controller)


def _native_builders(
    platforms: Sequence[str] = (), fmi: int = 2, start_values: Mapping[str, Any] | None = None
) -> _Builders:
    from ndob_fmu.native import build as native

    return _Builders(
        partial(native.build_native, platforms=platforms, fmi=fmi, start_values=start_values),
        partial(native.build_native_components, platforms=platforms, fmi=fmi),
        partial(native.build_native_controller, platforms=platforms, fmi=fmi),
    )


def _build_all(
    name: str | None, out: Path, components: bool, systems: Path | None, builders: _Builders
) -> Iterator[Path]:
    """Build one after the other and yield their paths; the controller, whose design may fail, is the last FMU.

    Without the name of a model the components that fit any plant are built.
    """
    from ndob_fmu.model.loading import load_model

    if name is None:
        if systems is not None:
            raise UsageError.report("build --systems", expected="the MODEL that the systems contain", received="none")
        yield from builders.components(out)
        return
    model = load_model(name)
    yield from builders.plant_and_observer(model, out)
    if components or systems is not None:
        yield from builders.components(out)
        yield builders.controller(model, out)
    if systems is not None:
        yield from _build_systems(out, systems)


def _build_systems(out: Path, systems: Path) -> Iterator[Path]:
    from ndob_fmu.cosim import parameter_sets
    from ndob_fmu.packages import build_ssp
    from ndob_fmu.support.shipped import shipped_folder

    for folder in sorted(path.parent for path in shipped_folder("ssp").glob("*/SystemStructure.ssd")):
        for one in (None, *parameter_sets(folder)):
            yield build_ssp(folder, out, systems, parameter_set=one)


def build_demo() -> Path:
    """Build all that is shipped into the folder of builds, and return the path of the demo's system."""
    deque(_build_all(DEMO_MODEL, BUILD / "fmus", True, BUILD / "ssp", _python_builders()), maxlen=0)
    return BUILD / "ssp" / f"{_DEMO_SYSTEM}.ssp"


def build_native_demo(folder: Path) -> Path:
    """Build the demo's system with FMUs in C in `folder` and return its path; FMUs that are up to date are kept.

    Raises UsageError where that cannot be done on this machine.
    """
    from ndob_fmu.model.loading import load_model
    from ndob_fmu.native.build import build_native
    from ndob_fmu.native.compile import PLATFORMS, this_platform
    from ndob_fmu.packages import build_ssp
    from ndob_fmu.support.shipped import shipped_folder

    if not this_platform():
        raise UsageError.report("native FMUs", expected=one_of("platform", PLATFORMS), received=sys.platform)
    build_native(load_model(DEMO_MODEL), folder / "fmus", keep=True)
    return build_ssp(shipped_folder("ssp") / _DEMO_SYSTEM, folder / "fmus", folder / "ssp")
