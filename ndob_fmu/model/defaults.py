"""Checks of the start values that a model gives the FMUs: of observer, generator and experiment. One line each."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from ndob_fmu.errors import ModelError, nearest, one_of
from ndob_fmu.model.checks import is_finite_number, listed, require_bounds, require_finite, require_not_negative
from ndob_fmu.runtime.blocks.disturbance import KINDS
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Experiment, ObserverDefaults, SignalDefaults


def require_defaults(
    model: str, disturbances: Sequence[str], observer: ObserverDefaults, signal: SignalDefaults, experiment: Experiment
) -> None:
    """Require start values that the FMUs can take.

    model: its name, for the messages
    disturbances: their names, (q2,)

    Raises ModelError.
    """
    of_observer = f"{model}.observer"
    _require_one_of(f"{of_observer}.method", observer.method, range(1, 3), "1 or 2")
    orders = range(HIGHEST_ORDER + 1)
    _require_one_of(f"{of_observer}.disturbance_order", observer.disturbance_order, orders, "0, 1, 2 or 3")
    for name in ("alpha", "pi_start", "pi_end"):
        _require_positive(f"{of_observer}.{name}", getattr(observer, name))
    for name in ("lag", "pi_ramp_time"):
        require_not_negative(f"{of_observer}.{name}", getattr(observer, name))
    if observer.disturbance_rate is not None:
        read_rate(model, disturbances, observer.disturbance_rate, (0.0,) * len(disturbances))
    if signal.kind not in KINDS:
        raise ModelError.report(
            f"{model}.disturbance.kind",
            expected=one_of("kind", KINDS, signal.kind),
            received=repr(signal.kind),
            likely=nearest(str(signal.kind), KINDS),
        )
    for name in ("amplitude", "frequency", "start_time"):
        require_finite(f"{model}.disturbance.{name}", getattr(signal, name))
    for name in ("stop_time", "step_size"):
        _require_positive(f"{model}.experiment.{name}", getattr(experiment, name), " (s)")


def read_rate(model: str, disturbances: Sequence[str], told: object, default: Sequence[float]) -> tuple[float, ...]:
    """Return the bound of the r-th derivative of each disturbance; one that is told by name may be left out."""
    where = f"{model}.observer.disturbance_rate"
    return require_bounds(where, listed(where, told, disturbances, default), len(disturbances))


def _require_one_of(where: str, value: object, allowed: Collection[object], expected: str) -> None:
    if value not in allowed:
        raise ModelError.report(where, expected=expected, received=repr(value))


def _require_positive(where: str, value: Any, unit: str = "") -> None:
    if not (is_finite_number(value) and value > 0):
        raise ModelError.report(where, expected=f"a finite number > 0{unit}", received=repr(value))
