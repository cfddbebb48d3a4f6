"""The example plants: they load as a user loads them, satisfy the paper's assumptions, and can be observed."""

import runpy

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ndob_fmu import check
from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.design.gains import paper_gains
from tests.helpers.problems import EXAMPLES, MODELS

SHARES = (1.0, 0.5)  # of the example's amplitude, so that two disturbances cannot be mistaken for one another
every_example = pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)


def shape(model):
    return len(model.states), len(model.inputs), len(model.outputs), linear_part(model).G.shape[1]


def observe(model, pi):
    """Integrate plant and observer (eqs. 22–23) in continuous time; return t (N,), d (N, q2) and d̂ (N, q2)."""
    linear, eq, n = linear_part(model), compile_model(model), len(model.states)
    gains = paper_gains(linear, pi=pi, alpha=model.observer.alpha)
    signal = model.disturbance
    generate = Generator(KINDS[signal.kind], signal.amplitude, signal.frequency, signal.start_time)
    shares = np.array(SHARES[: len(model.disturbances)])
    u, p = (0.0,) * len(model.inputs), model.parameter_values()

    def rates(t, z):
        x, xhat = z[:n], z[n:]
        correction = gains.L @ (linear.C @ (x - xhat))
        plant = eq.derivatives(x, u, generate(t) * shares, p)
        return np.concatenate([plant, np.array(eq.derivatives(xhat, u, 0.0 * shares, p)) + correction])

    stop = model.experiment.stop_time
    times = np.linspace(0.0, stop, 301)
    run = solve_ivp(
        rates, (0.0, stop), [*model.x0, *model.xhat0], "LSODA", times, rtol=1e-8, atol=1e-10, max_step=stop / 300
    )
    d = np.array([generate(t) * shares for t in times])
    residuals = (run.y[:n] - run.y[n:]).T @ linear.C.T
    estimate = np.sqrt(pi) * residuals @ gains.W.T @ linear.selector.T
    if eq.channel is not None:
        n_hat = np.array([eq.channel.direction(x_hat, u, p) for x_hat in run.y[n:].T])
        estimate = (np.sum(n_hat * estimate, axis=1) / np.sum(n_hat**2, axis=1))[:, None]
    return times, d, estimate


@every_example
def test_it_satisfies_every_assumption_with_its_own_defaults(path):
    report = check(MODELS[path.stem])
    assert report.passed, str(report)
    assert MODELS[path.stem].lipschitz == pytest.approx(report["lipschitz"].values["gamma"], rel=1e-3)


@every_example
def test_its_file_says_what_it_is_and_gives_units(path):
    text, model = runpy.run_path(str(path))["__doc__"], MODELS[path.stem]
    assert "·" in text
    assert "γ" in text
    named = {*model.states, *model.inputs, *model.outputs, *model.disturbances, *model.parameters}
    assert set(model.units) == named
    assert model.description


@every_example
def test_its_default_disturbance_is_one_that_its_bound_allows(path):
    model = MODELS[path.stem]
    assert model.disturbance.kind != "none"
    assert 0.0 < abs(model.disturbance.amplitude) <= np.min(model.disturbance_bound)
    assert model.disturbance.start_time < model.experiment.stop_time


@every_example
def test_its_fastest_observer_pole_can_be_followed_at_its_default_step(path):
    model = MODELS[path.stem]
    linear = linear_part(model)
    L = paper_gains(linear, pi=model.observer.pi_end, alpha=model.observer.alpha).L
    assert np.max(abs(np.linalg.eigvals(linear.A - L @ linear.C))) * model.experiment.step_size < 1.5


@every_example
def test_the_papers_observer_recovers_each_disturbance_and_the_better_the_larger_pi(path):
    model = MODELS[path.stem]
    amplitude = abs(model.disturbance.amplitude)
    for pi, allowed in ((model.observer.pi_end, 0.16), (1e3 * model.observer.pi_end, 0.05)):
        t, d, estimate = observe(model, pi)
        late = t > 0.7 * t[-1]
        assert np.max(abs(estimate - d)[late]) < allowed * amplitude


def test_the_examples_differ_in_shape_among_each_other_and_from_the_papers():
    shapes = {name: shape(model) for name, model in MODELS.items()}
    assert len(set(shapes.values())) == len(shapes)
    assert any(p > q for _, _, p, q in shapes.values())
    assert any(len(set(dimensions)) == 4 for dimensions in shapes.values())


def test_the_motors_zero_is_its_electrical_pole():
    model = MODELS["dc_motor"]
    pole = -model.parameters["resistance"] / model.parameters["inductance"]
    assert check(model)["minimum_phase"].values["zeros"] == pytest.approx([pole], rel=1e-12)


def test_the_motors_friction_is_odd_and_saturates():
    eq = compile_model(MODELS["dc_motor"])
    p = tuple(eq.parameters.values())
    slow, fast, backward = (eq.nonlinearity((0.0, rate, 0.0), (0.0,), p)[0] for rate in (0.5, 50.0, -50.0))
    assert slow == pytest.approx(-0.76 * 0.2, rel=5e-3)
    assert (fast, backward) == (pytest.approx(-0.2), pytest.approx(0.2))


def test_the_tank_drains_by_torricellis_law_and_stands_still_when_empty():
    eq = compile_model(MODELS["three_tank"])
    p = tuple(eq.parameters.values())
    assert eq.nonlinearity((0.0, 0.0, 25.0), (0.0, 0.0), p)[0] == pytest.approx(-20.0 * 5.0, rel=1e-3)
    assert eq.derivatives((0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), p) == (0.0, 0.0, 0.0)


def test_water_is_neither_made_nor_lost_between_the_tanks():
    model = MODELS["three_tank"]
    eq, p = compile_model(model), model.parameter_values()
    x, pumps, inflow = (33.0, 21.0, 12.0), (50.0, 40.0), (7.0,)
    stored = sum(eq.derivatives(x, pumps, inflow, p)) * model.parameters["area"]
    assert stored == pytest.approx(sum(pumps) + inflow[0] + eq.nonlinearity(x, pumps, p)[0])


def test_the_car_steers_left_with_its_wheels_and_is_pushed_by_the_wind():
    eq = compile_model(MODELS["car_in_crosswind"])
    p = tuple(eq.parameters.values())
    at_rest = (0.0, 0.0, 0.0, 0.0)
    _, _, side, yaw = eq.derivatives(at_rest, (0.01,), (0.0, 0.0), p)
    assert side > 0
    assert yaw > 0
    assert eq.derivatives(at_rest, (0.0,), (1.5, -2.5), p) == pytest.approx((0.0, 0.0, 1.0, -1.0))
