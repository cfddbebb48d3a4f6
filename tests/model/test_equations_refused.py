"""What cannot be used of a plant that is written as equations: one line each, with the likely cause."""

import pytest
import sympy

from ndob_fmu import Model
from ndob_fmu.errors import MESSAGE_LIMIT, ModelError

FIELDS = {
    "name": "Cart",
    "states": ["place", "rate"],
    "inputs": ["force"],
    "outputs": {"place": "place"},
    "disturbances": ["wind", "slope"],
    "dynamics": lambda x, u, d, p: [x.rate, (u.force - p.drag * x.rate**2 + d.wind) / p.mass + d.slope],
    "parameters": {"mass": 2.0, "drag": 0.1},
}


def refused(**changes):
    with pytest.raises(ModelError) as caught:
        Model(**(FIELDS | changes))
    message = str(caught.value)
    assert "\n" not in message
    assert ": expected " in message
    assert ", received " in message
    assert len(message) <= MESSAGE_LIMIT
    return message


def test_the_plant_itself_is_accepted():
    model = Model(**FIELDS)
    assert model.outputs == ("place",)
    assert model.vector_field.has_paper_form


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"A": [[0, 1], [0, 0]]}, ["Cart: expected dynamics, or A, B, C", "received dynamics and A", "written twice"]),
        ({"f": lambda x, u, p: [x.rate]}, ["received dynamics and f"]),
        ({"dynamics": None}, ["expected dynamics=lambda x, u, d, p: […], or A, C and G_d", "received no A and no C"]),
        (
            {"dynamics": None, "A": [[0, 1], [0, 0]], "C": [[1, 0]], "G_d": [[0, 0], [1, 1]]},
            ["outputs: expected a list of names", "belongs to dynamics"],
        ),
        ({"dynamics": lambda x, u, d, p: [x.rate]}, ["2 expressions, the derivatives of place, rate", "received 1"]),
        ({"dynamics": lambda x, u, p: [x.rate, u.force]}, ["dynamics(x, u, d, p) returning a list"]),
        (
            {"dynamics": lambda x, u, d, p: [x.rate, u.push]},
            ["Cart.dynamics, line", "the input force, received u.push", "not declared"],
        ),
        ({"dynamics": lambda x, u, d, p: [x.rate, sympy.Symbol("gravity")]}, ["received the symbol 'gravity'"]),
        (
            {"dynamics": lambda x, u, d, p: [x.rate, d.wind * d.slope]},
            ["affine in", "rate' = slope*wind", "enters linearly"],
        ),
        ({"dynamics": lambda x, u, d, p: [x.rate, d.wind * abs(d.wind)]}, ["affine in", "g(x, u) wind"]),
        ({"outputs": {"speed": lambda x, u, d, p: d.wind}}, ["outputs, speed", "four arguments", "accelerometer"]),
        (
            {"outputs": {"speed": lambda x, u, p: x.rate + sympy.Symbol("wind")}},
            ["does not depend on disturbances", "wind"],
        ),
        (
            {"outputs": {"speed": lambda x, u, p: x.velocity}},
            ["outputs, speed, line", "one of the states place, rate, received x.velocity"],
        ),
        (
            {"outputs": {"speed": lambda x, u, p: [x.rate]}},
            ["outputs, speed: expected real numbers or SymPy expressions"],
        ),
        ({"outputs": {"speed": "velocity"}}, ["outputs, speed: expected lambda x, u, p", "received 'velocity'"]),
        ({"outputs": ["speed"]}, ["outputs, speed: expected lambda x, u, p", "received 'speed'"]),
        ({"outputs": {"place": lambda x, u, p: 2 * x.place}}, ["output 'place' to be the state of that name"]),
        ({"outputs": {}}, ["Cart.outputs: expected at least one name"]),
        ({"ranges": {"place": (1.0, 1.0)}}, ["ranges, place: expected (lowest, highest)", "same or exchanged"]),
        ({"ranges": {"place": (2.0, 1.0)}}, ["ranges, place: expected (lowest, highest)"]),
        ({"ranges": {"place": 3.0}}, ["ranges, place: expected (lowest, highest)", "received 3.0"]),
        ({"ranges": {"place": (0.0, float("inf"))}}, ["two finite numbers"]),
        ({"ranges": {"plaze": (0.0, 1.0)}}, ["Cart.ranges", "received 'plaze'", "did you mean 'place'?"]),
        ({"ranges": {"wind": (0.0, 1.0)}}, ["Cart.ranges", "received 'wind'"]),
        ({"ranges": [(0.0, 1.0)]}, ["Cart.ranges: expected {state or input: (lowest, highest)}"]),
        (
            {"ranges": {"place": (1.0, 2.0)}},
            ["a range that holds the start values", "a start value of 0", "x0 is left out"],
        ),
        ({"disturbance_nominal": [1.0]}, ["Cart.disturbance_nominal: expected 2 finite numbers"]),
        ({"disturbance_nominal": float("nan")}, ["Cart.disturbance_nominal: expected 2 finite numbers"]),
        ({"channel_bound": 1.0}, ["Cart.channel_bound: expected a channel"]),
    ],
)
def test_a_mistake_ends_in_one_line(changes, words):
    message = refused(**changes)
    for part in words:
        assert part in message, message


def test_a_nominal_value_and_a_channel_exclude_each_other():
    turning = {
        "disturbances": ["wind"],
        "dynamics": lambda x, u, d, p: [x.rate, sympy.cos(x.place) * d.wind],
        "channel_bound": 1.0,
        "disturbance_nominal": 2.0,
    }
    assert "disturbance_nominal: expected 0 with a channel" in refused(**turning)
