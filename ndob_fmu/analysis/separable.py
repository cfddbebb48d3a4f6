"""Rows of the checks on sensor offsets and estimated parameters: whether samples tell them from a disturbance."""

from __future__ import annotations

from collections.abc import Mapping

from ndob_fmu.analysis.check_report import CheckRow
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.design.lumping import lumped
from ndob_fmu.runtime.design.separability import inseparable_offsets, inseparable_parameters


def separability_rows(model: Model, parameters: Mapping[str, float] | None) -> tuple[CheckRow, ...]:
    """Return a row for the offsets that are declared, and one for the parameters that are to be estimated.

    They inform and never fail: the observer works with what cannot be told apart, and its error bar covers it.
    """
    plant, values = lumped(compile_model(model)), model.parameter_values(parameters)
    biased = [i for i, std in enumerate(plant.bias_std) if std > 0.0]
    estimated = [i for i, std in enumerate(plant.parameter_std) if std > 0.0 and plant.observer.estimate_parameters]
    rows = []
    if biased:
        hidden = inseparable_offsets(plant, values, plant.xhat0, biased)
        rows.append(_row("offsets", {plant.outputs[i]: i not in hidden for i in biased}))
    if estimated:
        hidden = inseparable_parameters(plant, values, plant.xhat0, plant.xhat0_std, estimated)
        rows.append(_row("estimated_parameters", {list(plant.parameters)[i]: i not in hidden for i in estimated}))
    return tuple(rows)


def _row(name: str, told: Mapping[str, bool]) -> CheckRow:
    texts = (f"{one}: {'told' if apart else 'NOT told'} from a disturbance" for one, apart in told.items())
    return CheckRow(name, True, "for information", ", ".join(texts), values=told)
