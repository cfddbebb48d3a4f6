"""Build `<Name>Plant.fmu` and `<Name>Observer.fmu` from a model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ndob_fmu.analysis.assumptions import require_own_part
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.emit import emit_python
from ndob_fmu.fmu.archive import package
from ndob_fmu.fmu.bundle import bundle
from ndob_fmu.fmu.documentation_files import documentation_files
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.fmu.icon import draw_icon, model_icon
from ndob_fmu.fmu.manual import Part, manual
from ndob_fmu.interface.model_variables import observer_variables, plant_variables
from ndob_fmu.model.model import Model
from ndob_fmu.model.start_values import started, typed_values


def build(
    model: Model, out: str | Path = "build/fmus", *, start_values: Mapping[str, Any] | None = None
) -> tuple[Path, Path]:
    """Write `<Name>Plant.fmu` and `<Name>Observer.fmu` into the folder `out` and return their paths.

    start_values: of parameters, in place of the model's; each FMU has those of its own parameters

    Raises AssumptionError where the model's method lacks what it needs at the default parameters, and UsageError for
    start values that no parameter can have and where the folder cannot be written. A file that exists is replaced only
    by a complete new one.
    """
    values = given_values(model, start_values or {})
    require_own_part(model)
    return build_part(model, "Plant", out, values), build_part(model, "Observer", out, values)


def given_values(model: Model, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return start values of parameters of the two FMUs in their types; raise UsageError for others."""
    if not given:
        return {}
    eq = compile_model(model)
    return typed_values((*observer_variables(eq), *plant_variables(eq)), given)


def build_part(model: Model, part: Part, out: str | Path, start_values: Mapping[str, Any] | None = None) -> Path:
    """Write one of the two FMUs into the folder `out`, unchecked, and return its path.

    start_values: of `given_values`

    Raises UsageError where the folder cannot be written.
    """
    name, equations = f"{model.name}{part}", compile_model(model)
    variables = plant_variables(equations) if part == "Plant" else observer_variables(equations)
    variables, own = started(variables, start_values or {})
    return package(
        Path(out, f"{name}.fmu"),
        FmuDescription(name, model.description, variables, model.experiment),
        bundle(name, f"{part.lower()}_slave", f"{part}Slave", emit_python(model), ("EQUATIONS",), own),
        documentation_files(manual(model, part, variables), draw_icon(model_icon(model, part))),
    )
