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
from ndob_fmu.interface.model_variables import OWN_ORDER, for_each_disturbance, observer_variables
from ndob_fmu.interface.variables import Variable
from ndob_fmu.model.model import Model
from ndob_fmu.native import paper
from ndob_fmu.native.continued import CONTINUED, continued_text
from ndob_fmu.native.equations import NOT_ALWAYS, USED_BY_PRINTED, channel_size, equations_text, function_texts
from ndob_fmu.native.frozen import frozen_step_text
from ndob_fmu.native.join import joined
from ndob_fmu.native.runtime_code import part, places, runtime_texts
from ndob_fmu.native.short_code import fast, short
from ndob_fmu.native.sources import ComponentCode
from ndob_fmu.native.thunks import converged_step_thunk
from ndob_fmu.native.variable_table import number, quoted
from ndob_fmu.runtime.design.lumping import lumped
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations
from ndob_fmu.runtime.generated_steps import ObserverStep
from ndob_fmu.runtime.step.channel_observer import read_out
from ndob_fmu.runtime.step.delayed_outputs import PLACES
from ndob_fmu.runtime.step.fixed_lag import kept
from ndob_fmu.runtime.step.jump_bank import columns_of
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
    **USED_BY_PRINTED,
}
# What the component does around its observers.
_AROUND = {
    f"{_DESIGN}.separability": ("inseparable_offsets", "inseparable_parameters"),
    f"{_DESIGN}.pace": ("pace_of", "absurd"),
    f"{_DESIGN}.lumping": ("lumped_bound", "lumped_rate", "lumped_nominal"),
    f"{_STEP}.settings": ("check_settings",),
    f"{_STEP}.channel_observer": ("ChannelReading.read",),
    f"{_STEP}.fixed_lag": ("empty_lag", "later"),
}
_PER_DISTURBANCE = {
    "AT_BOUND": "disturbance_bound",
    "AT_RATE": "disturbance_rate",
    "AT_NOMINAL": "disturbance_nominal",
}
# Bytes that design and steps compute in, for each number that the FMU counts. Where they are too few, it takes more.
_MEMORY_OF_A_NUMBER = 112
_COPIED = ("PreparedObserver", "Tuned", "StepDesign", "ConvergedStep")
# What a log wants to know of the tuning.
_OF_TUNING = ("Intensities", "IntensityLaw")
# Functions of a step that leave their memory in use: the caller gives all of it back after it has written the state.
_UNMOVED = (
    f"{_STEP}.sampled_step.step_by_definition",
    f"{_STEP}.tracking_step.step_with_covariance",
    f"{_STEP}.reconsider.measured_or_reconsidered",
    f"{_STEP}.measurement_update.measure",
    f"{_STEP}.time_update.predict",
)
_PRINTED = (
    "nonlinearity",
    "derivatives",
    "output",
    "linearisation",
    "input_slopes",
    "sensitivity",
    "observer_constants",
)


# What is lumped in a plant with a channel, and what is asked of the plant as the model has it.
_LUMPED = ("derivatives", "linearisation", "input_slopes", "sensitivity")
_OF_PLANT = ("linearisation", "input_slopes")


def sampled_observer_text(model: Model) -> list[str]:
    """Return the C texts of method 2 for a model, one to come behind the other.

    Raises ModelError for an expression that has no C form.
    """
    eq = compile_model(model)
    return [*_runtime(_TRANSLATED, _COPIED), *_own_texts(model, eq)]


def _runtime(wanted: Mapping[str, Sequence[str]], copied: Sequence[str]) -> list[str]:
    return runtime_texts(wanted, copied=copied, stored=("SampledObserverState", *_OF_TUNING), unmoved=_UNMOVED)


def _own_texts(model: Model, eq: Equations) -> list[str]:
    printed = _printed(model, lumped(eq), eq)
    return [channel_size(eq), *short(part("faults.c")), *printed, *short(part("estimate.c"), part("sampled.c"))]


def observer_code(model: Model) -> ComponentCode:
    """Return the component of the model's observer, of both methods.

    Raises ModelError for an expression that has no C form.
    """
    eq = compile_model(model)
    variables = observer_variables(eq)
    own = [places(variables), _sizes(model, eq), _first_places(eq, variables)]
    reading = [part("channel.c")] if eq.channel else []
    around = [part("paper.c"), *own, part("shared.c"), part("call.c"), *reading, part("observer.c")]
    texts = [*_own_texts(model, eq), *short(*around)]
    runtime = _runtime({**_TRANSLATED, **_AROUND, **paper.TRANSLATED}, (*_COPIED, *paper.COPIED))
    whole = joined([*runtime, *texts], "start show step possible end tuning")
    return ComponentCode(whole, has_end=True, sizes_state=True)


def _sizes(model: Model, eq: Equations) -> str:
    """Return the sizes of the model, and what its observer has to know of it, as C text."""
    lumped_inputs = model.vector_field.G_d.cols
    sizes = {
        "STATES": len(eq.states),
        "INPUTS": len(eq.inputs),
        "OUTPUTS": len(eq.outputs),
        "DISTURBANCES": len(eq.disturbances),
        "LUMPED": lumped_inputs,
        "PARAMETERS": len(eq.parameters),
        "FEEDTHROUGH": int(any(eq.feedthrough)),
        "NUMBERS": _numbers(model, eq),
        "IN_PAST": f"{PLACES}u",
        "SIGNATURES": f"{columns_of(lumped_inputs)}u",
        "LAGGED": f"{kept(1.0) * lumped_inputs}u",
        "MEMORY_OF_A_NUMBER": f"{_MEMORY_OF_A_NUMBER}u",
    }
    ranges = (eq.ranges.get(name, (-inf, inf)) for name in eq.states)
    bounds = ", ".join(f"{{{number(low)}, {number(high)}}}" for low, high in ranges)
    names = ", ".join(map(quoted, eq.parameters)) or '""'
    return "\n".join(
        [
            *(f"#define {name} {value}" for name, value in sizes.items()),
            f"static const double bounds_of_states[][2] = {{{bounds}}};",
            f"static const double noise_of_states[] = {{{', '.join(map(number, eq.state_noise))}}};",
            *(["static const double no_own_order[LUMPED] = {0.0};"] if len(eq.disturbances) == 1 else []),
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
    if len(eq.disturbances) > 1:
        first["AT_OWN_ORDER"] = for_each_disturbance(OWN_ORDER, eq.disturbances)[d]
    if eq.parameters:
        name = next(iter(eq.parameters))
        first |= {"AT_PARAMETERS": name, "AT_PARAMETER_STD": f"{name}_std"}
    at = {place: reference[name] for place, name in first.items()}
    return "".join(
        f"#define {place} {at.get(place, 0)}\n" for place in [*at, *({"AT_PARAMETERS", "AT_PARAMETER_STD"} - at.keys())]
    )


def _numbers(model: Model, eq: Equations) -> int:
    """Return how many numbers a state has at most: with everything estimated, delays, offsets and a lag."""
    plant = lumped(eq)
    everything: dict[str, Any] = {
        "order": HIGHEST_ORDER,
        "lag": 1.0,
        "delay": [1.0] * len(eq.outputs),
        "bias_std": [1.0] * len(eq.outputs),
        "parameter_std": [1.0] * len(eq.parameters),
        "estimated": [True] * len(eq.parameters),
    }
    p = model.parameter_values()
    inner = sampled_observer(plant, p, observer_settings(plant, **everything), eq.xhat0)
    observer = read_out(eq, p, inner, disturbance_bound=eq.disturbance_bound, lag=everything["lag"])
    return _count(observer.init(eq.xhat0))


def _count(value: Any) -> int:
    """Return how many numbers a value consists of."""
    if isinstance(value, np.ndarray):
        return int(value.size)
    if isinstance(value, tuple):
        return sum(map(_count, value))
    return sum(_count(getattr(value, one.name)) for one in fields(value)) if is_dataclass(value) else 1


def _printed(model: Model, eq: Equations, plant: Equations) -> list[str]:
    """Return the printed functions, their thunks, and `set_equations`; with a channel also `set_plant`.

    eq: with the inputs that the observer estimates
    plant: as the model has it
    """
    n, m, p, q = len(eq.states), len(eq.inputs), len(eq.outputs), len(eq.disturbances)
    calls = {name: f"call_{name}" for name in [*_PRINTED, *(name for name in NOT_ALWAYS if getattr(eq, name))]}
    of_plant = {}
    if plant.channel is not None:
        calls |= {name: f"call_lumped_{name}" for name in _LUMPED}
        of_plant = {**{name: f"call_{name}" for name in _OF_PLANT}, "channel.value.direction": "call_direction"}
    names = [call.removeprefix("call_") for call in dict.fromkeys([*calls.values(), *of_plant.values()])]
    texts = function_texts(model, plant, names, ["observer_step"])
    head = next(line for text in texts for line in text.splitlines() if line.startswith("static int observer_step("))
    outputs = n + 5 * q + 2 * p + 2
    gain = re.findall(r"_gain_(\w+)", head)
    of_step = dict(zip(ObserverStep._fields, (n + 3 * q, n + 3 * q, q, p, m, p, p, outputs), strict=True))
    functions = {
        **{name: call for name, call in calls.items() if name != "observer_constants"},
        **({name: f"continued_{name}" for name in CONTINUED} if eq.ranges else {}),
        **{f"steps.{name}": f"call_{name}" for name in ("observer_constants", "observer_step")},
    }
    return [
        *texts,
        converged_step_thunk(gain, of_step),
        *fast(frozen_step_text(gain, of_step, m, p)),
        *short(
            continued_text(eq, calls),
            equations_text(eq, functions),
            equations_text(plant, of_plant or {name: f"call_{name}" for name in _OF_PLANT}, "set_plant"),
        ),
    ]
