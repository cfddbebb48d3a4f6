"""Build what completes a control loop around a plant and its observer: source, encoder, spring and controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.codegen.emit import emit_python
from ndob_fmu.errors import DesignError, ModelError, UsageError, some_of
from ndob_fmu.fmu.archive import package
from ndob_fmu.fmu.archive_files import surroundings
from ndob_fmu.fmu.bundle import bundle
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.fmu.icon import draw_block
from ndob_fmu.fmu.manual import TEXTS, page
from ndob_fmu.interface.component_variables import (
    DESCRIPTIONS,
    EXPERIMENT,
    controller_variables,
    encoder_variables,
    source_variables,
    spring_variables,
)
from ndob_fmu.interface.model_variables import Variable
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.blocks.controller import Controller, Feedback
from ndob_fmu.support.digits import certain_digits

_MARGIN = 1e-3
_SETTLED = 20.0
_COLOURS = ("#2d5a27", "#edf5ea")


@dataclass(frozen=True)
class ControllerDesign:
    """The controller of a model: the `feedback`, its closed-loop poles in 1/s, and what of each disturbance acts
    elsewhere than through the inputs, as a share of its direction: 0 where compensation is exact at any pace.
    """

    feedback: Feedback
    poles: NDArray[np.complex128]
    unmatched: Array


def design_controller(
    model: Model, *, regulated: Sequence[str] | None = None, pace: float | None = None
) -> ControllerDesign:
    """Design a state feedback by the least control effort that puts all poles to the left of −pace (1/s).

    It is the gain K of the Riccati equation for A + pace·I without weight on the state: poles to the right of −pace are
    mirrored at it, the others stay. A and B are linearised where the plant rests without reference and disturbance, or
    near x0 where there is no such position. regulated: as many states or outputs as there are inputs, by default the
    first states that are measured. pace: by default 20 over the stop time of the model's experiment.

    Raises UsageError for a pace or names that cannot be used, ModelError for a plant without inputs, DesignError where
    it cannot be brought to rest or its unstable part cannot be moved.
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
    return ControllerDesign(Feedback(names, gain), poles, _unmatched(linear_part(model).G_d, B))


def build_controller(
    model: Model,
    out: str | Path = "build/fmus",
    *,
    regulated: Sequence[str] | None = None,
    pace: float | None = None,
) -> Path:
    """Write `<Name>Controller.fmu` into the folder `out` and return its path.

    Arguments and errors are those of `design_controller`, and UsageError where the folder cannot be written.
    """
    feedback = design_controller(model, regulated=regulated, pace=pace).feedback
    text = f"{emit_python(model)}\n\nfrom {Feedback.__module__} import Feedback\n\nFEEDBACK = {feedback!r}\n"
    name = f"{model.name}Controller"
    variables = controller_variables(compile_model(model), feedback)
    return package(
        Path(out, f"{name}.fmu"),
        FmuDescription(name, DESCRIPTIONS["controller"], variables, compile_model(model).experiment),
        bundle(name, "controller_slave", "ControllerSlave", text, ("EQUATIONS", "FEEDBACK")),
        _extras(model.name, "controller", variables, ["$r$", r"$\hat{x}$", r"$\hat{d}$"], ["$u$"]),
    )


def build_components(out: str | Path = "build/fmus") -> tuple[Path, Path, Path]:
    """Write `DisturbanceSource.fmu`, `Encoder.fmu` and `TorsionSpring.fmu` into the folder `out`; return their paths.

    Raises UsageError where the folder cannot be written.
    """
    source, encoder, spring = source_variables(), encoder_variables(), spring_variables()
    return (
        package(
            Path(out, "DisturbanceSource.fmu"),
            FmuDescription("DisturbanceSource", DESCRIPTIONS["source"], source, EXPERIMENT),
            bundle("DisturbanceSource", "disturbance_source_slave", "DisturbanceSourceSlave"),
            _extras("Disturbance", "source", source, [], ["$d$"]),
        ),
        package(
            Path(out, "Encoder.fmu"),
            FmuDescription("Encoder", DESCRIPTIONS["encoder"], encoder, EXPERIMENT),
            bundle("Encoder", "encoder_slave", "EncoderSlave"),
            _extras("Encoder", "", encoder, [r"$\varphi$"], [r"$\varphi_m$"]),
        ),
        package(
            Path(out, "TorsionSpring.fmu"),
            FmuDescription("TorsionSpring", DESCRIPTIONS["spring"], spring, EXPERIMENT),
            bundle("TorsionSpring", "torsion_spring_slave", "TorsionSpringSlave"),
            _extras("Torsion", "spring", spring, [r"$\varphi_a$", r"$\varphi_b$"], [r"$\tau_a$", r"$\tau_b$"]),
        ),
    )


def _extras(
    name: str, label: str, variables: Sequence[Variable], into: Sequence[str], out: Sequence[str]
) -> dict[str, bytes]:
    part = label or name.lower()
    template = (TEXTS / f"{part}.html.jinja").read_text("utf-8")
    manual = page(f"{name}{label.capitalize()}", DESCRIPTIONS[part], template, variables)
    return surroundings(manual, draw_block(name, label, into, out, *_COLOURS))


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
