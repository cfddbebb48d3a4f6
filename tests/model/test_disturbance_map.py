"""The part of a disturbance that is a function of the states."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from ndob_fmu import Model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import MESSAGE_LIMIT, ModelError

MAP = {"force": {"speed": "friction", "place": "place"}}


def drive(**changes):
    """Return a drive whose spring and damper enter where the force does."""
    fields = {
        "name": "Drive",
        "states": ["place", "speed"],
        "inputs": ["push"],
        "outputs": ["place"],
        "disturbances": ["force"],
        "dynamics": lambda x, u, d, p: [x.speed, (u.push - p.damper * x.speed - sympy.sin(x.place) + d.force) / p.mass],
        "parameters": {"mass": 2.0, "damper": 0.5},
        "units": {"place": "m", "speed": "m/s", "force": "N"},
        **changes,
    }
    return Model(**fields)


def of_matrices(**changes):
    """Return a plant of matrices with an f that does not enter where the force does."""
    return Model(
        name="Chain",
        states=["place", "speed", "flow"],
        inputs=["push"],
        outputs=["place"],
        disturbances=["force"],
        A=[[0, 1, 0], [0, 0, 1], [0, 0, -3]],
        B=[[0], [0], [1]],
        C=[[1, 0, 0]],
        G_d=[[0], [2], [0]],
        G_f=[[0], [0], [1]],
        f=lambda x, u, p: [sympy.sin(x.flow)],
        **changes,
    )


def turning(**changes):
    """Return a plant with two forces whose directions turn with the place."""
    return Model(
        name="Turning",
        states=["place", "speed", "rate"],
        outputs=["place", "rate"],
        disturbances=["force", "torque"],
        dynamics=lambda x, u, d, p: [
            x.speed,
            sympy.cos(x.place) * d.force - sympy.sin(x.place) * d.torque,
            -x.rate + sympy.sin(x.place) * d.force + sympy.cos(x.place) * d.torque,
        ],
        **changes,
    )


def learned(model, seed):
    """Return the parameters of a model with coefficients of its map, and the map as a function of the states."""
    random = np.random.default_rng(seed)
    [one] = model.maps
    told = {name: float(random.normal()) for name in one.coefficients}
    told |= {name: value for name, value in one.parameters.items() if name not in told}
    told |= {"force_map_place_low": -0.4} if one.places else {}
    values = model.parameter_values(told)
    states = [model.symbols[name] for name in model.states]
    return values, sympy.lambdify(states, one.expression.subs({model.symbols[n]: v for n, v in told.items()}))


@pytest.mark.parametrize("make", [drive, of_matrices, turning])
def test_a_map_acts_as_a_disturbance_that_is_its_value(make):
    plain, mapped = make(), make(disturbance_map=MAP)
    values, value_at = learned(mapped, seed=3)
    random, own = np.random.default_rng(4), plain.parameter_values()
    for _ in range(5):
        x, u, d = (random.normal(size=len(names)) for names in (plain.states, plain.inputs, plain.disturbances))
        whole = [d[0] + value_at(*x), *d[1:]]
        expected = compile_model(plain).derivatives(x, u, whole, own)
        assert compile_model(mapped).derivatives(x, u, d, values) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("make", [drive, of_matrices, turning])
def test_a_map_that_no_log_has_told_changes_nothing(make):
    plain, mapped = make(), make(disturbance_map=MAP)
    x, u, d = [0.3, -0.2, 0.1][: len(plain.states)], [0.4][: len(plain.inputs)], [0.5, 0.6][: len(plain.disturbances)]
    found = compile_model(mapped).derivatives(x, u, d, mapped.parameter_values())
    assert found == compile_model(plain).derivatives(x, u, d, plain.parameter_values())


def test_a_plant_in_the_papers_form_keeps_it():
    assert drive(disturbance_map=MAP).matched
    assert of_matrices(disturbance_map=MAP).vector_field.has_paper_form


def test_a_map_stays_as_it_is_beyond_the_ends_of_a_place():
    model = drive(disturbance_map={"force": {"place": "place"}})
    _, value_at = learned(model, seed=5)
    assert value_at(3.0, 0.0) == pytest.approx(value_at(300.0, 0.0), abs=1e-3)
    assert abs(value_at(0.3, 0.0) - value_at(-0.3, 0.0)) > 0.1


def test_friction_depends_on_the_direction_of_motion_and_not_on_the_place_at_standstill():
    model = drive(disturbance_map={"force": {"speed": "friction"}})
    _, value_at = learned(model, seed=6)
    assert value_at(0.1, 0.5) == value_at(0.7, 0.5)
    assert abs(value_at(0.0, 0.05) - value_at(0.0, -0.05)) > 0.1


def test_parameters_of_a_map_have_the_units_of_what_they_are():
    model = drive(disturbance_map=MAP)
    assert model.units["force_map_speed_scale"] == "m/s"
    assert model.units["force_map_place_low"] == "m"
    assert {model.units[name] for name in model.maps[0].coefficients} == {"N"}


def test_a_model_may_hold_the_coefficients_of_its_map():
    model = drive(disturbance_map=MAP, parameters={"mass": 2.0, "damper": 0.5, "force_map_offset": 3.0})
    plain = drive()
    found = compile_model(model).derivatives([0.1, 0.2], [0.0], [0.0], model.parameter_values())
    assert found == pytest.approx(compile_model(plain).derivatives([0.1, 0.2], [0.0], [3.0], plain.parameter_values()))


@pytest.mark.parametrize(
    ("told", "says"),
    [
        (["speed"], "{disturbance: {state:"),
        ({"load": {"speed": "friction"}}, "'load'"),
        ({"force": {"rate": "friction"}}, "'rate'"),
        ({"force": {"speed": "viscous"}}, "'friction' or 'place'"),
        ({"force": {"speed": "friction", "place": "friction"}}, "one rate with friction"),
    ],
)
def test_a_map_of_what_is_not_there_is_refused(told, says):
    with pytest.raises(ModelError) as error:
        drive(disturbance_map=told)
    assert says in str(error.value)
    assert len(str(error.value)) < MESSAGE_LIMIT
    assert "\n" not in str(error.value)


def test_a_channel_has_no_map():
    with pytest.raises(ModelError, match="without a channel"):
        drive(
            dynamics=lambda x, u, d, p: [x.speed, sympy.cos(x.place) * d.force],
            channel_bound=1.0,
            disturbance_map=MAP,
        )
