"""Build native FMUs: plant, observer and controller of a model, and the components that fit any plant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ndob_fmu.analysis.assumptions import require_own_part
from ndob_fmu.analysis.controller_design import design_controller
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.fmu.build import given_values
from ndob_fmu.fmu.components import records
from ndob_fmu.fmu.controller import controller_record
from ndob_fmu.fmu.documentation_files import documentation_files
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.fmu.icon import draw_icon, model_icon
from ndob_fmu.fmu.manual import Part, manual, page
from ndob_fmu.fmu.record import ComponentRecord
from ndob_fmu.interface.model_variables import observer_variables, plant_variables
from ndob_fmu.interface.variables import Variable
from ndob_fmu.model.model import Model
from ndob_fmu.model.start_values import started
from ndob_fmu.native.compile import this_platform
from ndob_fmu.native.components import CODES
from ndob_fmu.native.controller import controller_code
from ndob_fmu.native.observer import observer_code
from ndob_fmu.native.origin import ORIGIN, origin
from ndob_fmu.native.package import package
from ndob_fmu.native.plant import plant_code
from ndob_fmu.native.sources import ComponentCode

_OWN_TEXTS = Path(__file__).parent / "documentation"
_NEEDS = (_OWN_TEXTS / "externalDependencies.txt").read_text("utf-8")


def build_native(
    model: Model,
    out: str | Path = "build/native/fmus",
    *,
    platforms: Sequence[str] = (),
    fmi: int = 2,
    keep: bool = False,
    start_values: Mapping[str, Any] | None = None,
) -> tuple[Path, Path]:
    """Write `<Name>Plant.fmu` and `<Name>Observer.fmu` in C into the folder `out` and return their paths.

    platforms: names in PLATFORMS; none: this machine's
    fmi: FMI's version, 2 or 3
    keep: leave FMUs as they are that would have the same sources and binaries for the same platforms
    start_values: of parameters, in place of the model's; each FMU has those of its own parameters

    Raises AssumptionError where the model lacks what method 2 needs, ModelError where an expression has no C form, and
    UsageError for start values that no parameter can have, and where a binary cannot be compiled or the folder not be
    written.
    """
    values = given_values(model, start_values or {})
    require_own_part(model)
    eq, chosen = compile_model(model), _chosen(platforms)
    parts: tuple[tuple[Part, tuple[Variable, ...], ComponentCode], ...] = (
        ("Plant", started(plant_variables(eq), values)[0], plant_code(model)),
        ("Observer", started(observer_variables(eq), values)[0], observer_code(model)),
    )
    plant, observer = (
        package(
            Path(out, f"{model.name}{part}.fmu"),
            FmuDescription(f"{model.name}{part}", model.description, variables, model.experiment),
            code,
            _documentation(manual(model, part, variables, needs=_NEEDS), draw_icon(model_icon(model, part)))
            | {ORIGIN: origin(model)},
            platforms=chosen,
            fmi=fmi,
            keep=keep,
        )
        for part, variables, code in parts
    )
    return plant, observer


def build_native_components(
    out: str | Path = "build/native/fmus", *, platforms: Sequence[str] = (), fmi: int = 2
) -> Iterator[Path]:
    """Write the components that fit any plant in C into the folder `out`, and yield their paths.

    platforms, fmi: as `build_native`

    Raises UsageError as `build_native`.
    """
    chosen = _chosen(platforms)
    for record in records():
        yield _component(record, CODES[record.name](record.variables), out, chosen, fmi)


def build_native_controller(
    model: Model,
    out: str | Path = "build/native/fmus",
    *,
    regulated: Sequence[str] | None = None,
    pace: float | None = None,
    platforms: Sequence[str] = (),
    fmi: int = 2,
) -> Path:
    """Write `<Name>Controller.fmu` in C into the folder `out` and return its path.

    regulated, pace: as `design_controller`
    platforms, fmi: as `build_native`

    Raises what `design_controller` raises, ModelError where an expression has no C form, and UsageError as
    `build_native`.
    """
    feedback = design_controller(model, regulated=regulated, pace=pace).feedback
    record = controller_record(model, feedback)
    return _component(record, controller_code(model, feedback), out, _chosen(platforms), fmi)


def _component(
    record: ComponentRecord, code: ComponentCode, out: str | Path, platforms: Sequence[str], fmi: int
) -> Path:
    return package(
        Path(out, f"{record.name}.fmu"),
        FmuDescription(record.name, record.text, record.variables, record.experiment),
        code,
        _documentation(
            page(record.name, record.text, record.page, record.variables, needs=_NEEDS), draw_icon(record.icon)
        ),
        platforms=platforms,
        fmi=fmi,
    )


def _chosen(platforms: Sequence[str]) -> Sequence[str]:
    return platforms or [one for one in [this_platform()] if one]


def _documentation(html: str, icon: bytes) -> dict[str, bytes]:
    """Return the files of the documentation, without those that speak of Python."""
    files = documentation_files(html, icon)
    del files["documentation/licenses/pythonfmu.txt"]
    own = {"externalDependencies.txt": "documentation", "license.txt": "documentation/licenses"}
    return files | {f"{folder}/{name}": (_OWN_TEXTS / name).read_bytes() for name, folder in own.items()}
