"""What each method needs of a model, checked before any design, each with its measured value."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial

from ndob_fmu.analysis.check_report import CheckReport, CheckRow, Part
from ndob_fmu.analysis.estimator_checks import estimator_rows
from ndob_fmu.analysis.paper_checks import paper_rows
from ndob_fmu.codegen.compile_model import working_part
from ndob_fmu.errors import UsageError
from ndob_fmu.model.model import Model, require_model
from ndob_fmu.support.progress import begin
from ndob_fmu.support.units import base_unit

_Rows = Callable[[Model, float, Mapping[str, float] | None], tuple[CheckRow, ...]]
_ROWS: Mapping[Part, _Rows] = {"method 2": estimator_rows, "method 1": paper_rows}
_PRESUPPOSED: Mapping[Part, _Rows] = {**_ROWS, "method 2": partial(estimator_rows, tuned=False)}


def check(model: Model, *, alpha: float | None = None, parameters: Mapping[str, float] | None = None) -> CheckReport:
    """Check what method 2 needs of a model, and the paper's assumptions, which method 1 needs.

    alpha: α in 1/s; None for the model's own.
    parameters: values that replace the model's.

    What fails is a row of the report, not an exception. Raises UsageError if α is not a positive number or `model` is
    no Model, and ModelError for a parameter that the model does not have, for an invalid unit, or where the plant
    cannot be evaluated.
    """
    require_model(model)
    _require_units(model)
    return _report(model, model.observer.alpha if alpha is None else alpha, parameters, _ROWS)


def required(model: Model, *, alpha: float, parameters: Mapping[str, float] | None) -> CheckReport:
    """Check as `check` does what a design presupposes, with nothing that depends on the settings it is made for.

    Raises AssumptionError where the model's own method lacks something, and what `check` raises.
    """
    require_model(model)
    return _report(model, alpha, parameters, _PRESUPPOSED).require()


def require_own_part(model: Model) -> None:
    """Check what the model's own method needs, without the other part, which only informs and takes longer.

    Raises AssumptionError where it lacks something, and what `check` raises.
    """
    require_model(model)
    _require_units(model)
    own = _decides(model)
    _report(model, model.observer.alpha, None, {own: _ROWS[own]}).require()


def _require_units(model: Model) -> None:
    """Raise ModelError for a text that is no unit; a Model itself does not load the library that knows them."""
    names = {unit: name for name, unit in model.units.items() if unit}
    for unit, name in sorted(names.items()):
        base_unit(unit, f"{model.name}.units, {name}")


def _report(
    model: Model, alpha: float, parameters: Mapping[str, float] | None, rows: Mapping[Part, _Rows]
) -> CheckReport:
    if not (isinstance(alpha, (int, float)) and math.isfinite(alpha) and alpha > 0):
        raise UsageError.report(f"alpha of {model.name}", expected="a finite number > 0 (1/s)", received=repr(alpha))
    working_part(model, parameters)  # which says what cannot be evaluated
    begin(f"measuring modes, ranks and zeros of {model.name}")
    return CheckReport(
        model=model.name,
        alpha=float(alpha),
        decides=_decides(model),
        parts={part: of_part(model, float(alpha), parameters) for part, of_part in rows.items()},
    )


def _decides(model: Model) -> Part:
    return "method 1" if model.observer.method == 1 else "method 2"
