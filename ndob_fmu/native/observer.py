"""The observer in C: the printed functions of the model, the translated design and steps, and what keeps their results.

`component/sampled.c` and `component/paper.c` say how the functions of methods 2 and 1 are called.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from math import inf
from typing import Any

import numpy as np

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import ModelError
from ndob_fmu.interface.model_variables import for_each_disturbance, observer_variables
from ndob_fmu.interface.variables import Variable
from ndob_fmu.model.model import Model
from ndob_fmu.native import paper
from ndob_fmu.native.continued import CONTINUED, continued_text
from ndob_fmu.native.equations import USED_BY_PRINTED, equations_text, function_texts
from ndob_fmu.native.frozen import frozen_step_text
from ndob_fmu.native.join import joined
from ndob_fmu.native.runtime_code import part, places, runtime_texts
from ndob_fmu.native.sources import ComponentCode
from ndob_fmu.native.thunks import converged_step_thunk
from ndob_fmu.native.variable_table import number, quoted
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations
from ndob_fmu.runtime.generated_steps import ObserverStep
from ndob_fmu.runtime.step.sampled_observer import sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings

_STEP, _DESIGN = "ndob_fmu.runtime.step", "ndob_fmu.runtime.design"
_TRANSLATED = {
    f"{_STEP}.sampled_step": (
        "start_state",
        "is_possible_state",
        "estimate_before_a_step",
        "step_to_tune_for",
        "step_by_definition",
        "step_converged",
    ),
    f"{_STEP}.preparation": ("prepared",),
    f"{_STEP}.tuned": ("tune",),
    f"{_STEP}.converged_step": ("converged_step",),
    f"{_DESIGN}.step_designs": ("StepDesigns.at",),
    f"{_DESIGN}.separability": ("inseparable_offsets", "inseparable_parameters"),
    f"{_DESIGN}.pace": ("pace_of",),
    **USED_BY_PRINTED,
}
_PER_DISTURBANCE = {
    "AT_BOUND": "disturbance_bound",
    "AT_RATE": "disturbance_rate",
    "AT_NOMINAL": "disturbance_nominal",
}
# Bytes that design and steps compute in, for each number of a state: they hold some tens of matrices of its size.
_MEMORY_OF_A_NUMBER = 256
_COPIED = ("PreparedObserver", "Tuned", "StepDesign", "ConvergedStep", "SampledObserverState")
_PRINTED = (
    "nonlinearity",
    "derivatives",
    "output",
    "linearisation",
    "input_slopes",
    "sensitivity",
    "observer_constants",
)


def sampled_observer_text(model: Model) -> list[str]:
    """Return the C texts of method 2 for a model, one to come behind the other.

    Raises ModelError for an expression that has no C form.
    """
    eq = compile_model(model)
    return [*_runtime(_TRANSLATED, _COPIED), *_own_texts(model, eq)]


def _runtime(wanted: Mapping[str, Sequence[str]], copied: Sequence[str]) -> list[str]:
    return runtime_texts(wanted, copied=copied, stored=("SampledObserverState",))


def _own_texts(model: Model, eq: Equations) -> list[str]:
    return [part("faults.c"), *_printed(model, eq), part("estimate.c"), part("sampled.c")]


def observer_code(model: Model) -> ComponentCode:
    """Return the component of the model's observer, of both methods.

    Raises ModelError for an expression that has no C form, and for a model whose observer is not built in C.
    """
    eq = compile_model(model)
    variables = observer_variables(eq)
    if eq.channel is not None:
        raise ModelError.report(
            model.name,
            expected="disturbances that act without a channel",
            received="a channel, whose observer is not built in C",
            likely="build with --target python, or write the plant with its own equations (dynamics=)",
        )
    own = [places(variables), _sizes(model, eq), _first_places(eq, variables)]
    texts = [*_own_texts(model, eq), part("paper.c"), *own, part("call.c"), part("observer.c")]
    runtime = _runtime({**_TRANSLATED, **paper.TRANSLATED}, (*_COPIED, *paper.COPIED))
    return ComponentCode(joined([*runtime, *texts], "start show step possible"))


def _sizes(model: Model, eq: Equations) -> str:
    """Return the sizes of the model, and what its observer has to know of it, as C text."""
    numbers = _numbers(model, eq)
    sizes = {
        "STATES": len(eq.states),
        "INPUTS": len(eq.inputs),
        "OUTPUTS": len(eq.outputs),
        "DISTURBANCES": len(eq.disturbances),
        "PARAMETERS": len(eq.parameters),
        "FEEDTHROUGH": int(any(eq.feedthrough)),
        "NUMBERS": numbers,
        "MEMORY": _MEMORY_OF_A_NUMBER * numbers,
    }
    ranges = (eq.ranges.get(name, (-inf, inf)) for name in eq.states)
    bounds = ", ".join(f"{{{number(low)}, {number(high)}}}" for low, high in ranges)
    names = ", ".join(map(quoted, eq.parameters)) or '""'
    return "\n".join(
        [
            *(f"#define {name} {value}" for name, value in sizes.items()),
            f"static const double bounds_of_states[][2] = {{{bounds}}};",
            f"static const double noise_of_states[] = {{{', '.join(map(number, eq.state_noise))}}};",
            f"static const char *const fmu_parameter_names[] = {{{names}}};",
            "",
        ]
    )


def _first_places(eq: Equations, variables: Sequence[Variable]) -> str:
    """Return the value references of the first of the variables that belong to states, outputs and disturbances."""
    reference = {variable.name: i for i, variable in enumerate(variables)}
    (d, *_) = eq.disturbances
    of_d = {name: for_each_disturbance(name, eq.disturbances)[d] for name in _PER_DISTURBANCE.values()}
    first = {
        "AT_HAT_START": f"{eq.states[0]}_hat_start",
        "AT_HAT_START_STD": f"{eq.states[0]}_hat_start_std",
        **{f"AT_{suffix.upper()}": f"{eq.outputs[0]}_{suffix}" for suffix in ("noise_std", "delay", "bias_std")},
        **{place: of_d[name] for place, name in _PER_DISTURBANCE.items()},
    }
    if eq.parameters:
        name = next(iter(eq.parameters))
        first |= {"AT_PARAMETERS": name, "AT_PARAMETER_STD": f"{name}_std"}
    at = {place: reference[name] for place, name in first.items()}
    return "".join(
        f"#define {place} {at.get(place, 0)}\n" for place in [*at, *({"AT_PARAMETERS", "AT_PARAMETER_STD"} - at.keys())]
    )


def _numbers(model: Model, eq: Equations) -> int:
    """Return how many numbers a state has at most: with everything estimated, delays, offsets and a lag."""
    everything: dict[str, Any] = {
        "order": HIGHEST_ORDER,
        "lag": 1.0,
        "delay": [1.0] * len(eq.outputs),
        "bias_std": [1.0] * len(eq.outputs),
        "parameter_std": [1.0] * len(eq.parameters),
        "estimated": [True] * len(eq.parameters),
    }
    observer = sampled_observer(eq, model.parameter_values(), observer_settings(eq, **everything), eq.xhat0)
    return _count(observer.init(eq.xhat0))


def _count(value: Any) -> int:
    """Return how many numbers a value consists of."""
    if isinstance(value, np.ndarray):
        return int(value.size)
    if isinstance(value, tuple):
        return sum(map(_count, value))
    return sum(_count(getattr(value, one.name)) for one in fields(value)) if is_dataclass(value) else 1


def _printed(model: Model, eq: Equations) -> list[str]:
    """Return the printed functions, their thunks, and `set_equations`."""
    n, m, p, q = len(eq.states), len(eq.inputs), len(eq.outputs), len(eq.disturbances)
    names = [*_PRINTED, *(("matrices",) if eq.matrices else ())]
    texts = function_texts(model, eq, names, ["observer_step"])
    head = next(line for text in texts for line in text.splitlines() if line.startswith("static int observer_step("))
    outputs = n + 5 * q + 2 * p + 2
    gain = re.findall(r"_gain_(\w+)", head)
    of_step = dict(zip(ObserverStep._fields, (n + 3 * q, n + 3 * q, q, p, m, p, p, outputs), strict=True))
    functions = {
        **{name: f"call_{name}" for name in names if name != "observer_constants"},
        **{name: f"{'continued' if eq.ranges else 'call'}_{name}" for name in CONTINUED},
        **{f"steps.{name}": f"call_{name}" for name in ("observer_constants", "observer_step")},
    }
    steps = [converged_step_thunk(gain, of_step), frozen_step_text(gain, of_step, m, p)]
    return [*texts, *steps, continued_text(eq), equations_text(eq, functions)]
