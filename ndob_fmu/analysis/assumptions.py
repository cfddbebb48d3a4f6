"""What each method needs of a model, checked before any design, each with its measured value."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ndob_fmu.analysis.check_report import CheckReport
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
    chosen = model.observer.alpha if alpha is None else alpha
    if not (isinstance(chosen, (int, float)) and math.isfinite(chosen) and chosen > 0):
        raise UsageError.report(f"alpha of {model.name}", expected="a finite number > 0 (1/s)", received=repr(chosen))
    working_part(model, parameters)  # which says what cannot be evaluated
    begin(f"measuring modes, ranks and zeros of {model.name}")
    return CheckReport(
        model=model.name,
        alpha=float(chosen),
        decides="method 1" if model.observer.method == 1 else "method 2",
        parts={
            "method 2": estimator_rows(model, float(chosen), parameters),
            "method 1": paper_rows(model, float(chosen), parameters),
        },
    )
