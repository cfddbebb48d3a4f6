"""The state feedback of `<Name>Controller`: the gain of least effort that moves the slow poles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

from ndob_fmu.codegen.compile_model import compile_model, working_part
from ndob_fmu.errors import DesignError, ModelError, UsageError, some_of
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.blocks.controller import Controller, Feedback
from ndob_fmu.support.digits import certain_digits

_MARGIN = 1e-3
_SETTLED = 20.0


@dataclass(frozen=True)
class ControllerDesign:
    """The controller of a model.

    feedback: the regulated signals and the gain
    poles: of the closed loop, in 1/s
    unmatched: for each disturbance, the part of its direction that the inputs do not reach, as a share of the
        direction; 0 where compensation is exact at any pace
    """

    feedback: Feedback
    poles: NDArray[np.complex128]
    unmatched: Array


def design_controller(
    model: Model, *, regulated: Sequence[str] | None = None, pace: float | None = None
) -> ControllerDesign:
    """Design a state feedback by the least control effort that puts all poles to the left of −pace (1/s).

    It is the gain K of the Riccati equation for A + pace·I without weight on the state: poles to the right of −pace are
    mirrored at it, the others stay. A and B are linearised at the equilibrium with references and disturbances of 0, or
    at one near x0 if there is none.

    regulated: as many states or outputs as there are inputs; by default the first states that are measured
    pace: in 1/s; by default 20 over the stop time of the model's experiment

    Raises UsageError for a pace or names that cannot be used, ModelError for a plant without inputs, DesignError if
    the plant has no equilibrium or a pole cannot be moved.
    """
    eq = compile_model(model)
    n, m = len(eq.states), len(eq.inputs)
    if m == 0:
        raise ModelError.report(f"the controller of {model.name}", expected="a plant with inputs", received="none")
    pace = _SETTLED / eq.experiment.stop_time if pace is None else pace
    if not (np.isfinite(pace) and pace > 0.0):
        raise UsageError.report("pace", expected="a finite number > 0, in 1/s", received=repr(pace))
    names = _regulated(model, regulated)
    parameters = model.parameter_values()
    controller = Controller(eq, parameters, names, np.zeros((m, n)), np.zeros(m), compensation=True)
    A, B = controller.jacobians(controller.start())
    try:
        P = solve_continuous_are(A + pace * np.eye(n), B, np.zeros((n, n)), np.eye(m))
        K = certain_digits(B.T @ P)
        poles = np.linalg.eigvals(A - B @ K).astype(complex)
        moved = bool(poles.real.max() <= -pace * (1.0 - _MARGIN))
    except np.linalg.LinAlgError:
        moved = False
    if not moved:
        raise DesignError.report(
            f"the controller of {model.name}",
            expected=f"a gain that puts all poles to the left of {-pace:g} 1/s",
            received="none",
            likely="the inputs do not reach a mode that is slower, or a pole lies on that line: try another pace",
        )
    gain = tuple(tuple(float(value) for value in row) for row in K)
    return ControllerDesign(Feedback(names, gain), poles, _unmatched(working_part(model).G_d, B))


def _regulated(model: Model, given: Sequence[str] | None) -> tuple[str, ...]:
    m = len(model.inputs)
    measured = [name for name in model.states if name in model.outputs]
    known = tuple(dict.fromkeys([*measured, *model.outputs, *model.states]))
    names = known[:m] if given is None else tuple(given)
    if len(names) != m or len(set(names)) != m or not set(names) <= set(known):
        raise UsageError.report(
            "regulated",
            expected=f"{m} of {some_of(known)}: one for each input",
            received=some_of(names),
        )
    return names


def _unmatched(G_d: Array, B: Array) -> Array:
    left = G_d - B @ np.linalg.lstsq(B, G_d, rcond=None)[0]
    return np.asarray(np.linalg.norm(left, axis=0) / np.linalg.norm(G_d, axis=0))
