"""Plants as in a textbook: disturbances in any direction, nonlinear sensors, ranges, nominal disturbances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy

from ndob_fmu import Model, ObserverDefaults
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import DesignError
from ndob_fmu.runtime.blocks.disturbance import Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.design.ranges import continued
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.step.paper_observer import paper_observer
from ndob_fmu.runtime.step.tuned import tune
from tests.helpers.general_plants import ARM, BALL, CART
from tests.helpers.observers import sampled_observer


def run(model, *, d_of, u_of, H, duration, seed=0, x_hat=None, **settings):
    """Return d̂ − d and d_std at the samples, and x̂, with a row for each step."""
    raw = compile_model(model)
    eq, p = continued(raw), model.parameter_values()
    observer = sampled_observer(eq, p, x_hat=eq.xhat0 if x_hat is None else x_hat, **settings)
    plant = Plant(raw, p, [Generator()] * len(eq.disturbances))
    x, state = plant.init(eq.x0, 0.0), observer.init(eq.xhat0 if x_hat is None else x_hat)
    random, rows = np.random.default_rng(seed), []
    before = u_of(0.0)
    for k in range(round(duration / H)):
        t = k * H
        # The sensors see the input until then.
        y = np.array(raw.output(x.x, before, p)) + np.array(eq.noise_std) * random.normal(size=len(eq.outputs))
        d, before = d_of(t), u_of(t)
        state, e = observer.step(state, before, y.tolist(), H)
        rows.append((np.array(e.d_at_sample) - d, e.d_std, np.array(e.x_at_sample) - x.x, e.x_hat, e.valid))
        x = plant.step(x, before, d, t + H, H)
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def test_both_torques_on_an_arm_with_two_links_are_estimated():
    """Their directions M(q)⁻¹ turn with the elbow, which the drives move by 2 rad here."""
    error, std, *_, valid = run(
        ARM,
        d_of=lambda t: [np.sin(2.0 * t), 0.5 * np.cos(3.0 * t)],
        u_of=lambda t: [0.5 * np.sin(t), np.sin(2.5 * t)],
        H=2e-3,
        duration=3.0,
        disturbance_rate=[2.0 * 9.0, 1.0 * 9.0],
    )
    assert valid.all()
    settled = slice(500, None)
    assert np.all(np.sqrt(np.mean(error[settled] ** 2, axis=0)) < 0.04 * np.array([2.0, 1.0]))
    assert np.all(np.mean(np.abs(error[settled]) < 2.0 * std[settled], axis=0) > 0.9)


def test_a_distance_and_an_acceleration_with_feed_through_tell_the_drag():
    """The force jumps twice a second; a sample taken for that of the new force would look like a jump of drag."""
    truth = {"rate": 1.0}
    _, _, errors, *_ = run(
        CART,
        d_of=lambda t: [truth["rate"] * np.sin(t)],
        u_of=lambda t: [4.0 if int(2.0 * t) % 2 else -4.0],
        H=1e-2,
        duration=4.0,
        order=1,
        disturbance_rate=[2.0],
    )
    drag = errors[100:, 2]
    assert np.max(np.abs(drag)) < 0.05


def test_an_output_that_does_not_follow_its_input_at_once_says_nothing_of_it():
    """With the samples of the distance alone the drag is known far less well."""
    alone = replace(
        CART, outputs=["distance"], output_equations={"distance": CART.output_equations["distance"]}, noise_std=1e-3
    )
    both, one = (
        run(
            model,
            d_of=lambda t: [np.sin(t)],
            u_of=lambda t: [1.0],
            H=1e-2,
            duration=4.0,
            order=1,
            disturbance_rate=[2.0],
        )
        for model in (CART, alone)
    )
    assert np.std(both[2][100:, 2]) < 0.5 * np.std(one[2][100:, 2])


@pytest.mark.parametrize("model", [ARM, CART, BALL], ids=lambda model: model.name)
def test_the_papers_designs_are_refused_in_one_line(model):
    eq, p = compile_model(model), model.parameter_values()
    schedule = PiSchedule(1.0, 1e6, 1.0)
    with pytest.raises(
        DesignError, match=r"for method 1: expected y = C x and constant directions.*method 2"
    ) as caught:
        paper_observer(eq, p, schedule, alpha=1.0)
    assert "…" not in str(caught.value)
    with pytest.raises(DesignError, match=r"disturbance_order: expected 1, 2 or 3, received 0.*the paper's design"):
        sampled_observer(eq, p, x_hat=eq.xhat0, order=0)


# -- ranges


def test_inside_its_ranges_a_plant_is_as_written():
    raw, p = compile_model(BALL), BALL.parameter_values()
    eq = continued(raw)
    at = ((5e-3, 0.1), (1.0,), (0.5,), p)
    for name in ("derivatives", "linearisation", "input_slopes", "sensitivity"):
        assert getattr(eq, name)(*at) == getattr(raw, name)(*at)
    assert eq.output((5e-3, 0.1), (1.0,), p) == raw.output((5e-3, 0.1), (1.0,), p)


def test_outside_its_ranges_a_plant_is_continued_by_its_tangent():
    raw, p = compile_model(BALL), BALL.parameter_values()
    eq = continued(raw)
    edge, beyond = ((2e-3, 0.1), (5.0,), (0.5,), p), ((-1e-3, 0.1), (7.0,), (0.5,), p)
    slopes = np.array(raw.linearisation(*edge)).reshape(3, 3)[:2]
    of_u = np.array(raw.input_slopes(*edge)).reshape(3, 1)[:2]
    expected = raw.derivatives(*edge) + slopes[:, 0] * -3e-3 + of_u[:, 0] * 2.0
    assert eq.derivatives(*beyond) == pytest.approx(expected, rel=1e-12)
    assert eq.output((-1e-3, 0.1), (7.0,), p) == pytest.approx([-1e-3])
    with pytest.raises(ZeroDivisionError):
        raw.derivatives((0.0, 0.1), (7.0,), (0.5,), p)
    assert np.all(np.isfinite(eq.derivatives((0.0, 0.1), (7.0,), (0.5,), p)))


def test_an_estimate_that_begins_outside_the_range_is_led_back():
    """The gap begins where the magnet would be passed, at −5 mm; its pull has no value at 0 on the way."""
    current = 1.05e-2 * np.sqrt(9.81 / 1e-4)  # a little more than holds the ball
    error, std, off, x_hat, valid = run(
        BALL,
        d_of=lambda t: [1.0],
        u_of=lambda t: [current],
        H=1e-3,
        duration=0.06,
        x_hat=(-5e-3, 0.0),
        disturbance_rate=[2e4],
    )
    assert np.all(np.isfinite(x_hat))
    assert valid[-1]
    assert np.max(np.abs(off[5:, 0])) < 1e-4
    assert np.all(np.abs(error[5:]) < 3.0 * std[5:])


def test_equations_that_overflow_outside_the_range_never_end_a_run():
    """exp(x) of a bad estimate of 1e4 has no value."""
    model = Model(
        name="Diode",
        states=["v"],
        outputs=["v"],
        disturbances=["i"],
        dynamics=lambda x, u, d, p: [1e-3 * (1 - sympy.exp(x.v / p.thermal)) + d.i],
        parameters={"thermal": 0.026},
        ranges={"v": (-1.0, 0.8)},
    )
    eq, p = continued(compile_model(model)), model.parameter_values()
    observer = sampled_observer(eq, p, x_hat=[1e4], x_std=[1e5])
    state = observer.init([1e4])
    for k in range(50):
        state, estimate = observer.step(state, (), [0.1 + 1e-4 * (-1) ** k], 1e-3)
    assert estimate.x_hat[0] == pytest.approx(0.1, abs=1e-2)


# -- nominal disturbances


def tank(nominal, **changes):
    """A tank that is heated by its feed; the feed's temperature counts from `nominal` where that is moved into f."""
    fields = {
        "name": "Tank",
        "states": ["level", "temperature"],
        "inputs": ["heater"],
        "outputs": ["temperature"],
        "disturbances": ["feed"],
        "A": [[-0.5, 0.1], [0.2, -1.5]],
        "B": [[0], [1]],
        "C": [[0, 1]],
        "G_d": [[0], [1.5]],
        "parameters": {"offset": 0.0},
        "f": lambda x, u, p: [p.offset + 0.1 * sympy.sin(x.temperature)],
        "lipschitz": 0.1,
        "disturbance_bound": 10.0,
        "noise_std": 1e-2,
        "x0": [0.0, 350.0],
        "xhat0": [0.0, 350.0],
        "xhat0_std": [1.0, 1.0],
        "disturbance_nominal": nominal,
        "observer": ObserverDefaults(alpha=0.1),
    }
    return Model(**(fields | changes))


def test_the_estimate_begins_at_the_nominal_value_and_its_bound_counts_from_there():
    error, std, *_ = run(
        tank(350.0),
        d_of=lambda t: [350.0 + 4.0 * np.sin(t)],
        u_of=lambda t: [0.0],
        H=0.02,
        duration=6.0,
        disturbance_rate=[10.0],
    )
    assert abs(error[0, 0]) < 1.0
    assert np.max(std) <= 10.0
    assert np.sqrt(np.mean(error[100:, 0] ** 2)) < 0.5


@pytest.mark.parametrize("method", ["paper", "sampled"])
def test_a_nominal_value_is_the_same_as_that_value_in_the_equations(method):
    shifted, offset = tank(350.0), tank(0.0, parameters={"offset": 350.0})
    told = []
    for model in (shifted, offset):
        eq, p = compile_model(model), model.parameter_values()
        if method == "paper":
            observer = paper_observer(
                eq, p, PiSchedule(1.0, 1e4, 1.0), alpha=0.1, disturbance_nominal=eq.disturbance_nominal
            )
        else:
            observer = sampled_observer(eq, p, x_hat=eq.xhat0)
        state = observer.init(eq.xhat0)
        random, rows = np.random.default_rng(1), []
        for k in range(200):
            y = [350.0 + np.sin(0.02 * k) + 1e-2 * random.normal() if k != 50 else np.nan]
            state, e = observer.step(state, (0.0,), y, 0.02)
            rows.append((e.d_hat[0], e.d_at_sample[0], *e.x_hat))
        told.append(np.array(rows))
    np.testing.assert_allclose(told[0][:, :2] - 350.0, told[1][:, :2], rtol=0, atol=1e-8)
    np.testing.assert_allclose(told[0][:, 2:], told[1][:, 2:], rtol=0, atol=1e-9)


def test_a_nominal_value_needs_a_model_of_the_disturbance():
    eq = compile_model(tank(350.0))
    with pytest.raises(DesignError, match=r"disturbance_nominal: expected .*0 with disturbance_order 0"):
        sampled_observer(eq, (0.0,), x_hat=eq.xhat0, order=0)


# -- uncertain parameters that act as the disturbance does

DRIVE = Model(
    name="Drive",
    states=["angle", "speed", "current"],
    inputs=["voltage"],
    outputs=["angle", "current"],
    disturbances=["load"],
    dynamics=lambda x, u, d, p: [
        x.speed,
        (p.flux * x.current - p.friction * x.speed) / p.inertia + 2.0 * d.load,
        (u.voltage - x.current) / p.inductance - p.flux * x.speed,
    ],
    parameters={"inertia": 0.5, "friction": 0.1, "flux": 1.0, "inductance": 0.1},
    parameter_std={"inertia": 0.05, "friction": 0.1, "flux": 0.05, "inductance": 0.01},
    noise_std=1e-3,
    disturbance_bound=1.0,
    observer=ObserverDefaults(disturbance_rate=1.0),
)


def test_parameters_that_act_in_the_directions_of_the_disturbance_alone_are_found():
    eq, p = compile_model(DRIVE), DRIVE.parameter_values()
    model = tune(sampled_observer(eq, p, x_hat=eq.xhat0), 1e-2).model
    assert model.like_disturbance.tolist() == [1.0, 1.0, 0.0, 0.0]
    x, u = np.array([0.3, 2.0, 1.5]), [4.0]
    inertia, friction = (1.0 * x[2] - 0.1 * x[1]) / 0.5**2 / 2.0 * 0.05, x[1] / 0.5 / 2.0 * 0.1
    xi = np.concatenate([x, [0.0, 0.0], p])
    assert model.taken_for_disturbance(xi, u) == pytest.approx([inertia**2 + friction**2], rel=1e-9)
    told = replace(DRIVE, outputs=["angle", "current"], observer=ObserverDefaults(estimate_parameters=True))
    estimated = tune(sampled_observer(compile_model(told), p, x_hat=eq.xhat0), 1e-2).model
    assert not estimated.like_disturbance.any()


def test_a_parameter_that_acts_as_two_disturbances_at_once_is_none_of_them():
    model = Model(
        name="Raft",
        states=["east", "north"],
        outputs=["east", "north"],
        inputs=["thrust"],
        disturbances=["wind_east", "wind_north"],
        dynamics=lambda x, u, d, p: [
            (u.thrust - p.drag * x.east + d.wind_east) / p.mass,
            (u.thrust - 2.0 * p.drag * x.north + d.wind_north - p.keel * x.north) / p.mass,
        ],
        parameters={"mass": 2.0, "drag": 0.5, "keel": 0.3},
        parameter_std=0.1,
    )
    eq = compile_model(model)
    observer = tune(sampled_observer(eq, model.parameter_values(), x_hat=eq.xhat0), 1e-2).model
    assert observer.like_disturbance.tolist() == [0.0, 0.0, 1.0]


def test_the_estimate_stays_smooth_where_wrong_parameters_exceed_the_bound_of_the_disturbance():
    """The drive's gain is told 40 % too small, ± 40 %: that is four times the bound."""
    model = Model(
        name="Fan",
        states=["speed"],
        inputs=["torque"],
        outputs=["speed"],
        disturbances=["load"],
        dynamics=lambda x, u, d, p: [p.gain * u.torque - x.speed + d.load],
        parameters={"gain": 1.0},
        parameter_std={"gain": 0.4},
        noise_std=0.01,
        observer=ObserverDefaults(disturbance_rate=4.0),
    )
    eq = compile_model(model)
    observer = sampled_observer(eq, model.parameter_values(), x_hat=eq.xhat0)
    state, random, H, speed, rows = observer.init(eq.xhat0), np.random.default_rng(1), 1e-2, 0.0, []
    for k in range(1000):
        d, u = 0.5 * np.sin(2.0 * k * H), 10.0 + 2.0 * np.sin(3.0 * k * H)
        state, e = observer.step(state, [u], [speed + 0.01 * random.normal()], H)
        rows.append((e.d_at_sample[0], e.d_at_sample[0] - d, e.d_std[0], e.valid))
        speed += H * (1.4 * u - speed + d)
    found, error, std, valid = np.array(rows, dtype=float)[300:].T
    assert np.all(valid)
    assert np.std(np.diff(found)) < 0.01
    assert np.sqrt(np.mean(error**2)) < 0.5
    assert np.all(np.abs(error) < 2.0 * std)
