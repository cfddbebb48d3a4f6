"""What the observer FMU can be told of sensors, model and time: each parameter changes what it should."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import MESSAGE_LIMIT
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from tests.helpers.fmi_instance import unpacked
from tests.helpers.problems import MODELS

MODEL = MODELS["flexible_joint"]
OUTPUTS = ("motor_angle", "link_angle")
H, STOP, LATE = 5e-3, 3.0, 1.0  # s; errors are judged from LATE on
BOUND, SIGMA = 5.0, 1e-4  # N·m, rad
FINE = 1e-6  # rad: noise that hides neither a delay nor a wrong parameter
FINE_SENSORS = {f"{y}_noise_std": FINE for y in OUTPUTS}
SINE = Generator(KINDS["sine"], 0.5 * BOUND, 1.0)
TOLD = {
    **{f"{y}_noise_std": SIGMA for y in OUTPUTS},
    "disturbance_bound": BOUND,
    "disturbance_order": 2,
    "disturbance_rate": 0.5 * BOUND * (2.0 * np.pi) ** 2,
}


def record(**parameters):
    """Return the time, the true disturbance and the samples without noise of both angles, one row for each step."""
    eq = compile_model(MODEL)
    plant = Plant(eq, MODEL.parameter_values(parameters), [SINE])
    x = plant.init(eq.x0, 0.0)
    t, y = np.arange(round(STOP / H)) * H, []
    for now in t:
        y.append([x.x[2], x.x[0]])
        x = plant.step(x, (2.0 * np.sin(5.0 * now),), (0.0,), now + H, H)
    return SimpleNamespace(t=t, d=np.array([SINE(now) for now in t]), y=np.array(y))


@pytest.fixture(scope="module")
def nominal():
    return record()


@pytest.fixture(scope="module")
def observer(flexible_joint):
    """Return a function that runs the observer FMU over samples and returns its outputs by name, as columns."""
    with unpacked(flexible_joint.observer) as instance:

        def run(samples, **parameters):
            one = instance()
            one.begin(**(TOLD | parameters))
            rows = [
                one.step(
                    k * H, H, motor_torque=2.0 * np.sin(5.0 * k * H), **dict(zip(OUTPUTS, map(float, y), strict=True))
                )
                for k, y in enumerate(samples)
            ]
            found = {name: np.array([row[name] for row in rows], dtype=float) for name in rows[0]}
            return SimpleNamespace(**found, said=one.said)

        yield run


def noisy(samples, sigma=SIGMA, seed=1):
    return samples + sigma * np.random.default_rng(seed).normal(size=samples.shape)


def rms(error):
    return float(np.sqrt(np.mean(np.square(error[round(LATE / H) :]))))


def error(found, truth):
    return rms(found.load_torque_at_sample - truth.d)


def coverage(found, truth):
    """Return the share of the samples whose error at the end of the step is within two error bars."""
    late = slice(round(LATE / H), -1)
    return float(
        np.mean(np.abs(found.load_torque_hat[:-1] - truth.d[1:])[late] <= 2.0 * found.load_torque_std[:-1][late])
    )


def test_an_output_with_more_noise_gets_a_larger_expected_residual_and_less_weight(observer, nominal):
    samples = noisy(nominal.y)
    same, own = (observer(samples, adapt_noise=False, motor_angle_noise_std=s) for s in (SIGMA, 100.0 * SIGMA))
    assert own.motor_angle_residual_std[-1] > 10.0 * same.motor_angle_residual_std[-1]
    samples[:, 0] += 99.0 * (samples - nominal.y)[:, 0]
    same, own = (observer(samples, adapt_noise=False, motor_angle_noise_std=s) for s in (SIGMA, 100.0 * SIGMA))
    assert error(own, nominal) < 0.5 * error(same, nominal)


def test_the_noise_follows_the_residuals_unless_that_is_turned_off(observer, nominal):
    samples = noisy(nominal.y, 10.0 * SIGMA)
    fixed, adapted = (observer(samples, adapt_noise=adapt) for adapt in (False, True))
    assert error(adapted, nominal) < 0.5 * error(fixed, nominal)
    assert coverage(adapted, nominal) > 0.9 > coverage(fixed, nominal)


def test_the_consistency_is_one_where_all_is_true_and_far_above_where_the_noise_is_not(observer, nominal):
    true, false = (observer(noisy(nominal.y, s), adapt_noise=False) for s in (SIGMA, 5.0 * SIGMA))
    assert true.consistency[-1] == pytest.approx(1.0, abs=0.4)
    assert false.consistency[-1] > 5.0


@pytest.mark.parametrize(("late", "better"), [("motor_angle", 0.5), ("link_angle", 0.6)])
def test_a_delay_that_is_told_is_taken_into_account(observer, nominal, late, better):
    steps, column = 4, OUTPUTS.index(late)
    samples = noisy(nominal.y, FINE)
    samples[steps:, column] = samples[:-steps, column].copy()
    samples[:steps, column] = np.nan
    untold, told = (observer(samples, **FINE_SENSORS, **{f"{late}_delay": delay}) for delay in (0.0, steps * H))
    assert error(told, nominal) < better * error(untold, nominal)
    assert np.all(told.valid)


def test_an_offset_that_is_told_of_is_found(observer, nominal):
    samples = noisy(nominal.y, FINE)
    samples[:, 0] += 0.05
    untold, told = (observer(samples, **FINE_SENSORS, motor_angle_bias_std=std) for std in (0.0, 0.05))
    offset = [abs(float(np.mean((found.load_torque_at_sample - nominal.d)[-200:]))) for found in (untold, told)]
    assert offset[1] < 0.1 * offset[0]
    assert coverage(told, nominal) > 0.9 > coverage(untold, nominal)
    assert not told.said


@pytest.mark.parametrize("parameter", ["joint_stiffness", "motor_damping"])
def test_an_uncertain_parameter_widens_the_error_bar(observer, parameter):
    truth = record(**{parameter: 1.1})
    samples = noisy(truth.y, FINE)
    sure, unsure = (observer(samples, **FINE_SENSORS, **{f"{parameter}_std": std}) for std in (0.0, 0.1))
    assert coverage(unsure, truth) > 0.9 > 1.5 * coverage(sure, truth)
    assert error(unsure, truth) <= (1.0 + 1e-6) * error(sure, truth)  # where it acts as d does, only the bar is another


def test_an_uncertain_parameter_is_estimated_where_that_is_asked_for(observer):
    truth = record(joint_stiffness=1.1)
    samples = noisy(truth.y, FINE)
    given, estimated = (
        observer(samples, **FINE_SENSORS, joint_stiffness_std=0.1, estimate_parameters=wanted)
        for wanted in (False, True)
    )
    assert error(estimated, truth) < 0.9 * error(given, truth)
    assert not estimated.said


def test_a_parameter_whose_error_a_disturbance_imitates_is_not_estimated_and_the_log_says_so(observer):
    """The damping acts on the motor as the load does."""
    truth = record(motor_damping=1.1)
    samples = noisy(truth.y, FINE)
    given, refused = (
        observer(samples, **FINE_SENSORS, motor_damping_std=0.1, estimate_parameters=wanted) for wanted in (False, True)
    )
    np.testing.assert_array_equal(refused.load_torque_hat, given.load_torque_hat)
    (message,) = refused.said
    assert "motor_damping is not estimated" in message
    assert "load_torque" in message
    assert not given.said


def test_later_samples_improve_the_lagged_estimate(observer, nominal):
    samples, steps = noisy(nominal.y), 10
    now, later = observer(samples), observer(samples, lag=steps * H)
    np.testing.assert_array_equal(now.load_torque_lagged, now.load_torque_at_sample)
    late = slice(round(LATE / H), None)
    lagged = later.load_torque_lagged[steps:] - nominal.d[:-steps]
    assert rms(lagged) < 0.5 * error(now, nominal)
    assert np.all(later.load_torque_lagged_std[late] < later.load_torque_std[late])
    assert np.mean(np.abs(lagged) <= 2.0 * later.load_torque_lagged_std[steps:]) > 0.9
    assert error(later, nominal) == pytest.approx(error(now, nominal), rel=0.01)


def test_offsets_that_no_sample_can_tell_from_the_disturbance_are_logged(observer, nominal):
    """Both offsets together move the joint's angles as a constant load does."""
    both = observer(nominal.y[:2], motor_angle_bias_std=0.05, link_angle_bias_std=0.05)
    assert len(both.said) == 2
    for name, message in zip(OUTPUTS, both.said, strict=True):
        assert message.startswith(f"{name}_bias_std: ")
        assert "constant load_torque" in message
        assert len(message) <= MESSAGE_LIMIT
