"""Which offsets and parameters samples can tell from a disturbance: plants whose answer is plain."""

from __future__ import annotations

import pytest
import sympy

from ndob_fmu import Model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.runtime.design.separability import inseparable_offsets, inseparable_parameters

MASS, STIFFNESS, DAMPING, GAIN, DRAG, STREAM = sympy.symbols("mass stiffness damping gain drag stream")


def oscillator(**changes):
    """A mass on a spring, pushed by an unknown force; a filter follows its position."""
    fields = {
        "name": "Oscillator",
        "states": ["position", "rate", "filtered"],
        "outputs": ["position", "filtered"],
        "disturbances": ["force"],
        "A": [[0, 1, 0], [-STIFFNESS / MASS, -DAMPING / MASS, 0], [STREAM, 0, -STREAM]],
        "C": [[1, 0, 0], [0, 0, 1]],
        "G_d": [[0], [1 / MASS], [0]],
        "G_f": [[0], [1 / MASS], [0]],
        "f": lambda x, u, p: [-p.drag * x.rate**3],
        "parameters": {"mass": 2.0, "stiffness": 8.0, "damping": 0.5, "drag": 0.1, "stream": 3.0},
    }
    return compile_model(Model(**(fields | changes)))


def offsets(equations, biased):
    return inseparable_offsets(equations, tuple(equations.parameters.values()), (0.0, 0.0, 0.0), biased)


def parameters(equations, uncertain=None):
    names = list(equations.parameters)
    indices = range(len(names)) if uncertain is None else [names.index(name) for name in uncertain]
    values = tuple(equations.parameters.values())
    found = inseparable_parameters(equations, values, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), indices)
    return {names[i] for i in found}


def test_a_second_sensor_of_the_same_quantity_separates_an_offset_of_the_first():
    assert offsets(oscillator(), [0]) == ()
    assert offsets(oscillator(), [1]) == ()


def test_offsets_of_all_sensors_together_look_like_a_constant_force():
    assert offsets(oscillator(), [0, 1]) == (0, 1)
    alone = oscillator(outputs=["position"], C=[[1, 0, 0]])
    assert offsets(alone, [0]) == (0,)


def test_an_offset_of_a_rate_is_separable_because_a_constant_force_moves_nothing():
    rates = oscillator(outputs=["position", "rate"], C=[[1, 0, 0], [0, 1, 0]])
    assert offsets(rates, [1]) == ()
    assert offsets(rates, [0, 1]) == (0,)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_units_do_not_matter(scale):
    scaled = oscillator(
        A=[[0, 1, 0], [-STIFFNESS / MASS, -DAMPING / MASS, 0], [STREAM * scale, 0, -STREAM]],
        G_d=[[0], [1 / MASS / scale], [0]],
        G_f=[[0], [1 / MASS / scale], [0]],
    )
    assert offsets(scaled, [0]) == ()
    assert offsets(scaled, [0, 1]) == (0, 1)
    assert parameters(scaled) == {"mass", "stiffness", "damping", "drag"}


def test_parameters_in_the_channel_of_the_disturbance_are_not_told_from_it():
    assert parameters(oscillator()) == {"mass", "stiffness", "damping", "drag"}
    assert parameters(oscillator(), ["stream", "drag"]) == {"drag"}


def test_a_parameter_of_a_sensor_is_told_from_it():
    amplified = oscillator(
        C=[[GAIN, 0, 0], [0, 0, 1]],
        outputs=["amplified", "filtered"],
        parameters={"mass": 2.0, "stiffness": 8.0, "damping": 0.5, "drag": 0.1, "stream": 3.0, "gain": 1.5},
    )
    assert "gain" not in parameters(amplified)
    assert "damping" in parameters(amplified)
