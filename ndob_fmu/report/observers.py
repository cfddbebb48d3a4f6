"""Figures of an observer: estimates with their error bars, outputs beside their predictions, residuals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from ndob_fmu.report.lines import ERROR, ESTIMATE, MEASURED, TRUTH, Panels, magnitude
from ndob_fmu.report.recorded_run import RecordedRun
from ndob_fmu.report.signals import usual_range
from ndob_fmu.runtime.arrays import Array

Figure = tuple[str, go.Figure]
_RESIDUAL = "_residual"
_CUT = "The axis shows the usual range; double-click on the plot shows all."


@dataclass(frozen=True)
class _Prediction:
    """ŷ (k,) at the rows of the samples, the rows in which their residuals are, or the reason why it is not known."""

    samples: NDArray[np.intp]
    residuals: NDArray[np.intp]
    values: Array
    reason: str = ""


def disturbance_figures(record: RecordedRun) -> Iterator[Figure]:
    """Yield each estimated disturbance with a band of ±2 std, and its error where the truth is recorded."""
    for component, disturbances in record.observers().items():
        for name in disturbances:
            yield _disturbance(record, component, name)


def output_figures(record: RecordedRun) -> Iterator[Figure]:
    """Yield each output beside what the observer predicts of it, and the residual on an axis of its own."""
    for component in record.observers():
        for residual in record.recording.names:
            if residual.startswith(f"{component}.") and residual.endswith(_RESIDUAL):
                yield _output(record, component, residual[len(component) + 1 : -len(_RESIDUAL)])


def state_figures(record: RecordedRun) -> Iterator[Figure]:
    """Yield each estimated state beside the plant's, and their difference."""
    disturbances = {f"{part}.{name}_hat" for part, names in record.observers().items() for name in names}
    for estimate in record.recording.names:
        truth = record.truth(estimate)
        if truth is None or estimate in disturbances:
            continue
        panels = Panels([1.0, 0.8])
        true, found = record.recording[truth], record.recording[estimate]
        panels.line(1, record.time, true, truth, TRUTH)
        panels.line(1, record.time, found, estimate, ESTIMATE)
        panels.line(2, record.time, magnitude(found - true), "|error|", ERROR)
        limits = usual_range(true, found)
        panels.axis(1, _label(record, truth), limits)
        panels.magnitude(2, f"|error| [{_unit(record, truth)}]", found - true)
        yield f"{estimate}, {truth}, and the difference between them.{' ' + _CUT if limits else ''}", panels.figure


def input_figures(record: RecordedRun) -> Iterator[Figure]:
    """Yield the recorded inputs: those from a file, and those of observers but for the measured outputs."""
    observed = record.observers()
    names = [*record.inputs, *(port for component in observed for port in record.driven(component))]
    measured = {name.removesuffix(_RESIDUAL) for name in record.recording.names if name.endswith(_RESIDUAL)}
    by_unit: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        if name not in measured and record.input(name) is not None:
            by_unit.setdefault(_unit(record, name), []).append(name)
    if by_unit:
        panels = Panels([0.8] * len(by_unit))
        for panel, (unit, ports) in enumerate(by_unit.items(), 1):
            for port in ports:
                signal = record.input(port)
                if signal is not None:
                    panels.line(panel, record.time, signal, port, {"width": 1.4, "shape": "hv"})
            panels.axis(panel, f"[{unit}]")
        yield "Inputs as they were recorded; each value is held until the next.", panels.figure


def _disturbance(record: RecordedRun, component: str, name: str) -> Figure:
    estimate, std = record.recording[f"{component}.{name}_hat"], record.recording[f"{component}.{name}_std"]
    truth = record.truth(f"{component}.{name}_hat")
    true = None if truth is None else record.recording[truth]
    panels = Panels([1.3] if true is None else [1.3, 0.9])
    panels.band(1, record.time, estimate - 2.0 * std, estimate + 2.0 * std, "estimate ± 2 std")
    panels.line(1, record.time, estimate, f"{component}.{name}_hat", ESTIMATE)
    trusted = ~_coasting(record, component)
    shown = [estimate, estimate - 2.0 * std, estimate + 2.0 * std, *([] if true is None else [true])]
    limits = usual_range(*shown, usual=trusted)
    caption = [f"The disturbance {name} as {component} estimates it, with its error bar of ±2 standard deviations."]
    unit = _unit(record, f"{component}.{name}_hat")
    if true is not None and truth is not None:
        panels.line(1, record.time, true, truth, TRUTH)
        error = estimate - true
        panels.line(2, record.time, magnitude(error), "|error|", ERROR)
        panels.line(2, record.time, magnitude(2.0 * std), "2 std", {**ESTIMATE, "dash": "dot"})
        panels.magnitude(2, f"|error| [{unit}]", error, 2.0 * std)
        caption.append(_quality(record, component, error, std, unit))
    panels.axis(1, f"{name} [{unit}]", limits)
    caption += [_shade_invalid(record, component, panels), _CUT if limits else ""]
    return " ".join(filter(None, caption)), panels.figure


def _quality(record: RecordedRun, component: str, error: Array, std: Array, unit: str) -> str:
    """Return how large the error is in the second half, and how often it lies within the band, without the start."""
    late = record.time >= 0.5 * (record.time[0] + record.time[-1])
    judged = late & np.isfinite(error) & ~_coasting(record, component)
    if not judged.any():
        return "In the second half no estimate is valid."
    rms = float(np.sqrt(np.mean(error[judged] ** 2)))
    within = float(np.mean(np.abs(error[judged]) <= 2.0 * std[judged]))
    return (
        f"In the second half the RMS error is {rms:.3g} {unit}, and {100 * within:.3g} % of the rows lie in the band."
    )


def _output(record: RecordedRun, component: str, name: str) -> Figure:
    port = f"{component}.{name}"
    residual = record.recording[f"{port}{_RESIDUAL}"]
    measured = record.input(port)
    predicted = _prediction(record, port, measured, residual)
    unit = _unit(record, f"{port}{_RESIDUAL}")
    panels = Panels([0.9] if measured is None else [1.0, 0.8])
    caption = []
    if measured is None:
        caption.append(f"Residual of {name}; what {component} measured of it was not recorded.")
    else:
        panels.line(1, record.time, measured, f"measured {name}", MEASURED)
        panels.axis(1, f"{name} [{unit}]", limits := usual_range(measured, predicted.values))
        caption.append(f"{name} as {component} measured it")
        if predicted.reason:
            caption[-1] += f"; its prediction is left out: {predicted.reason}."
        else:
            panels.line(1, record.time[predicted.samples], predicted.values, f"predicted {name}", ESTIMATE)
            lost = ~np.isfinite(measured[predicted.samples])
            residual[predicted.residuals[lost]] = np.nan  # the observer gives 0 for a sample that it did not get
            caption[-1] += ", beside the prediction, which is the sample minus its residual."
        caption += [_CUT] if limits else []
    last = 1 if measured is None else 2
    panels.line(last, record.time, residual, f"residual of {name}", ERROR)
    std = record.get(f"{port}{_RESIDUAL}_std")
    shown = [residual]
    if std is None:
        caption.append(f"No band: the recording has no {name}{_RESIDUAL}_std to expect the residual by.")
    elif not std.any():
        caption.append(f"No band: {name}{_RESIDUAL}_std is 0, for method 1 does not say what to expect.")
    else:
        panels.band(last, record.time, -2.0 * std, 2.0 * std, "± 2 std expected", edge=True)
        shown += [-2.0 * std, 2.0 * std]
        known = np.isfinite(residual)
        usual = float(np.mean(np.abs(residual[known]) <= 2.0 * std[known])) if known.any() else 0.0
        caption.append(f"{100 * usual:.3g} % of the residuals lie within the ±2 standard deviations that are expected.")
    panels.axis(last, f"residual [{unit}]", usual_range(*shown, usual=~_coasting(record, component)))
    caption.append(_shade_invalid(record, component, panels))
    return " ".join(filter(None, caption)), panels.figure


def _prediction(record: RecordedRun, port: str, measured: Array | None, residual: Array) -> _Prediction:
    """Return ŷ = y − (y − ŷ): no FMU has it as an output.

    The residual in row k is of the sample with which the step that ends there began, one step earlier; of that at the
    step's end where a component that has stepped before brings it.
    """
    no_rows = np.zeros(0, dtype=np.intp)
    none = no_rows, no_rows, np.zeros(0)
    rows = record.step_rows(port.partition(".")[0])
    if measured is None:
        return _Prediction(*none, "the sample was not recorded")
    if rows is None:
        return _Prediction(*none, "rows were recorded less often than samples were taken")
    ends = np.arange(rows, len(residual), rows)
    samples = ends if record.sees_end_of_step(port) else ends - rows
    return _Prediction(samples, ends, measured[samples] - residual[ends])


def _shade_invalid(record: RecordedRun, component: str, panels: Panels) -> str:
    coasting = _coasting(record, component)
    if not coasting.any():
        return ""
    panels.shade(record.time, coasting)
    return f"Shaded: valid is false, the estimate coasts ({100 * float(np.mean(coasting)):.2g} % of the rows)."


def _coasting(record: RecordedRun, component: str) -> NDArray[np.bool_]:
    """Return in which rows `valid` is false, (rows,), after steps in which no sample could be used."""
    valid = record.get(f"{component}.valid")
    coasting = np.zeros(len(record.time), dtype=bool) if valid is None else np.asarray(valid < 0.5)
    coasting[0] = False  # before the first step
    return coasting


def _label(record: RecordedRun, name: str) -> str:
    return f"{name.partition('.')[2]} [{_unit(record, name)}]"


def _unit(record: RecordedRun, name: str) -> str:
    return record.units.get(name) or "1"
