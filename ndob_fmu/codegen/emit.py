"""Write a symbolic model as source text: the module of plain functions that the runtime and the FMUs use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ndob_fmu.codegen.build_definitions import build_definitions
from ndob_fmu.codegen.build_step import build_steps
from ndob_fmu.codegen.default_rate import disturbance_rate
from ndob_fmu.codegen.once_per_model import once_per_model
from ndob_fmu.codegen.print_python import IMPORTS, print_function
from ndob_fmu.model.model import SAID_BY_NAME, Model
from ndob_fmu.model.vector_field import VectorField

_HEADER = '''"""Equations of {name}, written from its symbolic model; do not edit."""

{imports}
from ndob_fmu.runtime.equations import {names}
from ndob_fmu.runtime.generated_steps import Steps
'''

_IMPORTED = ["Equations", "Experiment", "ObserverDefaults", "SignalDefaults"]

# What a disturbance with a channel adds: the plant is the one with lumped inputs w, driven by w = n(x, u) d.
_PLANT_WITH_CHANNEL = """def derivatives(_x, _u, _d, _p):
    return lumped_derivatives(_x, _u, [_n * _d[0] for _n in direction(_x, _u, _p)], _p)
"""


class FunctionTexts:
    """The texts of a model's functions, by `names` in the order of the module. Each is written when asked for, once."""

    def __init__(self, field: VectorField, ranges: Mapping[str, Sequence[float]]) -> None:
        limits = {symbol.name: ranges[symbol.name] for symbol in field.not_linear if symbol.name in ranges}
        definitions, steps = build_definitions(field), build_steps(field, limits)
        self._builders = {**definitions, **steps}
        self._texts = {"derivatives": _PLANT_WITH_CHANNEL} if field.direction else {}
        self.names = (*definitions, *(name for name in self._texts if name not in definitions), *steps)

    def __getitem__(self, name: str) -> str:
        """Return the text of a function. Raises ModelError where an expression has no Python form."""
        if name not in self._texts:
            self._texts[name] = print_function(self._builders[name]())
        return self._texts[name]


@once_per_model
def function_texts(model: Model) -> FunctionTexts:
    """Return the texts of the model's functions, which only know each other by their names."""
    return FunctionTexts(model.vector_field, model.ranges)


@once_per_model
def emit_python(model: Model) -> str:
    """Return the text of a Python module that defines EQUATIONS for the model.

    Raises ModelError where an expression has no Python form.
    """
    functions = function_texts(model)
    return "\n\n".join([header_text(model), *(functions[name] for name in functions.names), equations_text(model)])


def header_text(model: Model) -> str:
    """Return the beginning of the module: what its functions and EQUATIONS use."""
    imported = ", ".join(["Channel"] * bool(model.channel_expressions) + _IMPORTED)
    return _HEADER.format(name=model.name, imports=IMPORTS, names=imported)


@once_per_model
def equations_text(model: Model) -> str:
    """Return the end of the module: EQUATIONS, made of the functions before it."""
    field = model.vector_field
    fields: dict[str, Any] = {
        "name": model.name,
        "description": model.description,
        "states": model.states,
        "inputs": model.inputs,
        "outputs": model.outputs,
        "disturbances": model.disturbances,
        "parameters": {name: float(value) for name, value in model.parameters.items()},
        "units": dict(model.units),
        "descriptions": dict(model.descriptions),
        "x0": model.x0,
        "xhat0": model.xhat0,
        "xhat0_std": model.xhat0_std,
        "disturbance_bound": model.disturbance_bound,
        "disturbance_rate": disturbance_rate(model, function_texts(model)),
        "disturbance_nominal": model.disturbance_nominal,
        **{label: model.told(label) for label in SAID_BY_NAME},
        "lipschitz": float(model.lipschitz or 0.0),
        "f_states": field.nonlinear_states,
        "ranges": dict(model.ranges),
        "feedthrough": field.feedthrough,
        "matched": model.matched,
        "observer": model.observer,
        "disturbance": model.disturbance,
        "experiment": model.experiment,
    }
    lines = [f"    {name}={value!r}," for name, value in fields.items()]
    functions = ("nonlinearity", "derivatives", "output", "linearisation", "input_slopes", "sensitivity")
    lines += [f"    {name}={name}," for name in functions]
    lines.append(f"    matrices={'matrices' if field.has_paper_form else None},")
    if field.jumps_at:
        lines.append("    surfaces=surfaces,")
    steps = ("plant_constants", "plant_trial", "observer_constants", "observer_step")
    lines.append(f"    steps=Steps({', '.join(f'{name}={name}' for name in steps)}),")
    if model.channel_expressions:
        bounds = f"bound={model.channel_bound!r}, rate={float(model.channel_rate)!r}"
        lumped = ("derivatives", "linearisation", "input_slopes", "sensitivity")
        of_lumped = ", ".join(f"{name}=lumped_{name}" for name in lumped)
        lines.append(f"    channel=Channel({bounds}, direction=direction, {of_lumped}),")
    return "EQUATIONS = Equations(\n" + "\n".join(lines) + "\n)\n"
