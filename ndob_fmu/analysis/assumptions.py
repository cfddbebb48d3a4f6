"""What each method needs of a model, checked before any design, each with its measured value."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from ndob_fmu.analysis.check_report import CheckReport, Part
from ndob_fmu.analysis.estimator_checks import estimator_rows
from ndob_fmu.analysis.paper_checks import paper_rows
from ndob_fmu.codegen.compile_model import working_part
from ndob_fmu.errors import UsageError
from ndob_fmu.model.model import Model, require_model
from ndob_fmu.support.progress import begin


def check(model: Model, *, alpha: float | None = None, parameters: Mapping[str, float] | None = None) -> CheckReport:
    """Check what method 2 needs of a model, and the paper's assumptions, which method 1 needs.

    alpha: α in 1/s; None for the model's own.
    parameters: values that replace the model's.

    What fails is a row of the report, not an exception. Raises UsageError if α is not a positive number or `model` is
    no Model, and ModelError for a parameter that the model does not have, or where the plant cannot be evaluated.
    """
    require_model(model)
    return _report(model, model.observer.alpha if alpha is None else alpha, parameters, ("method 2", "method 1"))


def require_own_part(model: Model) -> None:
    """Check what the model's own method needs, without the other part, which only informs and takes longer.

    Raises AssumptionError where it lacks something, and what `check` raises.
    """
    require_model(model)
    _report(model, model.observer.alpha, None, (_decides(model),)).require()


def _report(model: Model, alpha: float, parameters: Mapping[str, float] | None, parts: Iterable[Part]) -> CheckReport:
    if not (isinstance(alpha, (int, float)) and math.isfinite(alpha) and alpha > 0):
        raise UsageError.report(f"alpha of {model.name}", expected="a finite number > 0 (1/s)", received=repr(alpha))
    working_part(model, parameters)  # which says what cannot be evaluated
    begin(f"measuring modes, ranks and zeros of {model.name}")
    rows = {"method 2": estimator_rows, "method 1": paper_rows}
    return CheckReport(
        model=model.name,
        alpha=float(alpha),
        decides=_decides(model),
        parts={part: rows[part](model, float(alpha), parameters) for part in parts},
    )


def _decides(model: Model) -> Part:
    return "method 1" if model.observer.method == 1 else "method 2"
