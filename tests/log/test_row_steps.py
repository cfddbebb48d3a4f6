"""Steps from all rows of a log at once take as many parts as the plant needs, and the same ones for near parameters."""

import numpy as np
import pytest
import scipy.linalg
import sympy

from ndob_fmu import Model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.row_functions import row_functions
from ndob_fmu.interface.told_observer import told_observer
from ndob_fmu.log.fit.class_fit import fit_class
from ndob_fmu.log.fit.parameter_step import most_likely
from ndob_fmu.log.fit.setup import Setup
from ndob_fmu.log.made_log import Sensor, make_log, walk
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.row_steps import Motion, calm_units
from ndob_fmu.log.told_values import told_values
from ndob_fmu.runtime.step.time_update import predict_mean

FRICTION, STEP = 0.05, 5e-3


def drive(width):
    """Return a drive whose dry friction is smooth within a rate of `width` (rad/s)."""
    return Model(
        name="Drive",
        states=["angle", "rate"],
        inputs=["torque"],
        outputs=["angle", "rate"],
        disturbances=["load"],
        dynamics=lambda x, u, d, p: [
            x.rate,
            (u.torque - 2e-3 * x.rate - FRICTION * sympy.tanh(x.rate / width) + d.load) / p.inertia,
        ],
        parameters={"inertia": 1.6e-3},
        noise_std={"angle": 3e-5, "rate": 0.02},
        disturbance_bound=0.5,
    )


def tuned(model, H=STEP):
    """Return the equations of all rows, of an observer that is tuned to steps of H (s)."""
    eq = compile_model(model)
    found = told_observer(eq, told_values(eq, {"disturbance_order": 1}).__getitem__, print).tuned(H).model
    return RowModel(found, row_functions(model))


@pytest.mark.parametrize("width", [0.1, 0.01, 1e-3, 1e-4])
def test_a_drive_that_friction_stops_or_turns_within_a_step_ends_it_where_it_does_one_by_one(width):
    """Its time constant at rate 0 is 3 ms to 3 µs. Between two samples that are away from there, nothing shows it."""
    rows, random = tuned(drive(width)), np.random.default_rng(2)
    K = 300
    xi = np.column_stack([random.uniform(-1.0, 1.0, K), random.uniform(-0.3, 0.3, K), random.uniform(-0.04, 0.04, K)])
    u = random.uniform(-0.06, 0.06, (K, 1))
    motion = Motion(rows, xi, u, np.full(K, STEP))
    true = np.array([predict_mean(rows.model, one, of.tolist(), STEP) for one, of in zip(xi, u, strict=True)])
    channel = rows.model.noise_directions
    found = motion.steps(motion.plan(xi), channel, np.ones((K, channel.shape[1])), apart=True)
    of_load = rows.model.bound[0] / 1.6e-3 * STEP
    assert np.mean(np.abs(true[:, 1]) < width) > 0.05
    error = np.abs(found.end - true)[:, 1] / of_load
    assert np.max(error) < 0.02
    assert np.quantile(error, 0.95) < 1e-4


@pytest.mark.parametrize("width", [0.1, 0.01])
def test_the_error_bar_of_a_parameter_is_that_of_near_parameters(tmp_path, width):
    """Where a step took one more part for one of two values, a wrong slope made the bar a hundredth of itself."""
    model, stop = drive(width), 3.0

    def follow(t, y):
        return [0.9 * (3.0 * np.sin(2.0 * t) + np.sin(5.3 * t) - y[0]) - 0.05 * y[1]]

    path = tmp_path / "log.csv"
    make_log(
        model, path, follow, step=STEP, stop_time=stop, disturbances={"load": walk(0.1, 1.0, 3, stop)}, jitter=0.03,
        sensors={"angle": Sensor(noise_std=3e-5), "rate": Sensor(noise_std=0.02)}, gaps=[(1.0, 1.1)],
    )  # fmt: skip
    eq = compile_model(model)
    setup = Setup(model, eq, told_values(eq, {}), ("inertia",), 0.0, None)
    run = setup.online(path, None, None)
    problem = setup.problem(run, 1)
    fit = fit_class(problem, setup.trajectory(run, problem), most_likely)
    steps = [
        most_likely(problem, fit.trajectory, np.array([inertia]), fit.noise)
        for inertia in np.linspace(1.5e-3, 1.7e-3, 9)
    ]
    bars = np.array([np.sqrt(one.covariance[0, 0]) for one in steps])
    assert bars.max() < 1.4 * bars.min()


def test_steps_of_a_linear_plant_are_those_of_its_exponential():
    """Along a long log, an error of 1e-6 in the frequency of an oscillation is one of a parameter."""
    model = Model(
        name="Spring", states=["place", "rate"], inputs=["push"], outputs=["place"], disturbances=["force"],
        dynamics=lambda x, u, d, p: [x.rate, u.push + d.force - 100.0 * x.place - x.rate], disturbance_bound=1.0,
    )  # fmt: skip
    rows, H, xi = tuned(model, 0.02), 0.02, np.array([[0.5, 2.0, -0.7]])
    motion, channel = Motion(rows, xi, np.array([[0.3]]), np.full(1, H)), rows.model.noise_directions
    end = motion.steps(motion.plan(xi), channel, np.ones((1, channel.shape[1])), apart=True).end[0]
    F = np.array([[0.0, 1.0, 0.0], [-100.0, -1.0, 1.0], [0.0, 0.0, 0.0]])
    at_rest = np.array([(0.3 - 0.7) / 100.0, 0.0, -0.7])  # with this input and disturbance
    np.testing.assert_allclose(end, at_rest + scipy.linalg.expm(F * H) @ (xi[0] - at_rest), rtol=0, atol=1e-13)


def test_a_chain_of_integrators_has_units_in_which_its_norm_is_small_however_long_the_step():
    chain = np.diag([5.0, 0.1], 1)
    units = calm_units(chain, np.ones(3))
    assert (chain * (units / units[:, None])).sum(axis=0).max() <= 0.25


@pytest.mark.parametrize(("frequency", "parts"), [(200.0, 1), (400.0, 2), (800.0, 4)])
def test_an_oscillator_whose_states_have_far_different_sizes_takes_as_many_parts_as_its_frequency_needs(
    frequency, parts
):
    model = Model(
        name="Oscillator",
        states=["place", "rate"],
        inputs=["force"],
        outputs=["place"],
        disturbances=["load"],
        dynamics=lambda x, u, d, p: [x.rate, u.force + d.load - frequency**2 * x.place],
        parameters={},
    )
    rows, K = tuned(model, 1e-3), 50
    zeros, H = np.zeros((K, rows.model.layout.size)), np.full(K, 1e-3)
    H[7] = 0.05  # a gap in the log, which takes more parts than the other steps do
    plan = Motion(rows, zeros, np.zeros((K, 1)), H).plan(zeros)
    assert np.median(plan.parts) == parts
    assert plan.parts[7] == 16


def test_units_stay_as_they_are_where_the_plant_is_too_fast_for_any():
    fast = np.array([[4.0, 1.0], [0.0, 0.1]])
    np.testing.assert_array_equal(calm_units(fast, np.array([2.0, 4.0])), [2.0, 4.0])
