"""How fast the disturbance changes where the user does not say: as fast as the plant does.

A sine of amplitude D₀ at ω, the geometric mean of the magnitudes of the plant's modes that the disturbance drives,
where the plant starts. Integrators have no pace. A plant of integrators alone takes ten periods in the experiment.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any, Protocol

import numpy as np

from ndob_fmu.codegen.print_python import IMPORTS
from ndob_fmu.model.defaults import read_rate
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.design.operating_point import driven_modes, middle_input
from ndob_fmu.runtime.numerics.zeros import ComplexArray

_PERIODS = 10.0
_FASTEST = 1e50  # 1/s: parameters that are out of proportion
_SLOW = 1e-4  # of the fastest mode: slower ones count as integrators


class Texts(Protocol):
    """The texts of a model's functions by their names."""

    def __getitem__(self, name: str) -> str:
        """Return the text of a function."""


def disturbance_rate(model: Model, texts: Texts) -> tuple[float, ...]:
    """Return the bound (q2,) of |d^{(r)}|, of |ḋ| for r = 0: what the model says, or else that of sines at the pace.

    texts: of the model's functions
    """
    told, order = model.observer.disturbance_rate, max(model.observer.disturbance_order, 1)
    rate: Any = {} if told is None else told
    complete = not isinstance(rate, Mapping) or {*model.disturbances} <= {*rate}
    pace = 0.0 if complete else _pace(model, texts)
    return read_rate(model.name, model.disturbances, rate, [bound * pace**order for bound in model.disturbance_bound])


def _pace(model: Model, texts: Texts) -> float:
    """Return ω (rad/s)."""
    modes = np.abs(_modes(model, texts))
    moving = modes[modes > _SLOW * max(modes, default=0.0)]
    if not len(moving) or max(modes) > _FASTEST:
        return 2.0 * pi * _PERIODS / model.experiment.stop_time
    return float(f"{np.exp(np.mean(np.log(moving))):.3g}")  # its last digits depend on the processor


def _modes(model: Model, texts: Texts) -> ComplexArray:
    """Return the modes (1/s) that the disturbances drive at the start; none where that cannot be evaluated."""
    namespace: dict[str, Any] = {}
    _ = texts["nonlinearity"]  # a function without a Python form is refused by its name, not by its derivative's
    exec(f"{IMPORTS}\n{texts['linearisation']}", namespace)
    n, q = len(model.states), len(model.disturbances)
    u = middle_input(model.inputs, {name: (low, high) for name, (low, high) in model.ranges.items()})
    try:
        entries = namespace["linearisation"](model.xhat0, u, model.disturbance_nominal, model.parameter_values())
    except (ArithmeticError, ValueError, TypeError):
        return np.zeros(0, dtype=complex)
    both = np.array(entries, dtype=float).reshape(-1, n + q)[:n]
    return driven_modes(both[:, :n], both[:, n:]) if np.all(np.isfinite(both)) else np.zeros(0, dtype=complex)
