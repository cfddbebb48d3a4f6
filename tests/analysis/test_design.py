"""What `design` tells about the sampled-data observer at a step: gains, predictions, bounds and warnings."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy

from ndob_fmu.analysis.assumptions import check
from ndob_fmu.analysis.design import design
from ndob_fmu.analysis.sampled_data_design import SampledDataDesign
from ndob_fmu.cli import main
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import DesignError, ModelError, UsageError
from ndob_fmu.model.model import Model
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import MODELS

FLEXIBLE = MODELS["flexible_joint"]
SINE = 2.0 * np.pi


def test_without_a_step_there_is_the_papers_design_alone():
    assert not isinstance(design(FLEXIBLE), SampledDataDesign)


def test_the_prediction_is_what_noise_and_pace_allow_at_best():
    # The least sum of bias and noise over all intensities, for a sine of 1 Hz and amplitude 1 at 1 ms. The tuning
    # minimises their mean square, whose minimum lies near it.
    for order, noise, best in ((2, 1e-4, 0.130), (3, 1e-4, 0.093), (2, 1e-6, 0.0165), (3, 1e-6, 0.0075)):
        found = design(FLEXIBLE, step_size=1e-3, disturbance_order=order, noise_std=noise, disturbance_rate=SINE**order)
        assert found.predicted_bias[0] + found.predicted_noise[0] <= 1.15 * best


def test_the_filters_poles_are_stable_and_belong_to_the_printed_gain():
    found = design(FLEXIBLE, step_size=1e-3, disturbance_order=3, noise_std=1e-5)
    assert found.K.shape == (7, 2)
    assert found.filter_poles.shape == (7,)
    assert np.max(np.abs(found.filter_poles)) < 1.0
    assert found.M_H is None


def test_without_a_disturbance_order_the_read_out_of_the_error_goes_to_the_papers_as_the_step_shrinks():
    errors = []
    steps = (1e-5, 1e-6)
    for step in steps:
        found = design(FLEXIBLE, pi=1e12, alpha=1.0, step_size=step, disturbance_order=0)
        errors.append(np.abs(found.K / step - found.L).max() / np.abs(found.L).max())
        assert found.M_H.shape == (1, 2)
    assert np.log(errors[0] / errors[1]) / np.log(steps[0] / steps[1]) == pytest.approx(1.0, abs=0.05)


def test_pi_sets_the_pace_where_it_is_given_and_is_reported_where_it_is_not():
    tuned = design(FLEXIBLE, step_size=1e-3, disturbance_order=2, noise_std=1e-5)
    again = design(FLEXIBLE, pi=tuned.equivalent_pi, step_size=1e-3, disturbance_order=2, noise_std=1e-5)
    np.testing.assert_allclose(again.K, tuned.K, rtol=1e-6, atol=1e-6 * np.abs(tuned.K).max())
    assert again.equivalent_pi == pytest.approx(tuned.equivalent_pi)
    assert not np.allclose(design(FLEXIBLE, pi=1e9, step_size=1e-3, noise_std=1e-5).K, tuned.K)


def test_a_step_too_coarse_for_the_bandwidth_asked_is_warned_of():
    coarse = design(FLEXIBLE, pi=1e12, step_size=1e-2, disturbance_order=0)
    assert any("too coarse" in text and "H ω₀ = 10" in text for text in coarse.warnings)
    assert "warning: pi asks for a bandwidth" in str(coarse)
    fine = design(FLEXIBLE, pi=1e8, step_size=1e-3, disturbance_order=0, noise_std=1e-6)
    assert fine.warnings == ()


def test_where_the_step_limits_and_not_the_noise_it_says_so():
    limited = design(FLEXIBLE, step_size=1e-2, noise_std=0.0)
    assert any("limits the accuracy, not the noise" in text for text in limited.warnings)


def test_an_estimate_that_tells_nothing_is_warned_of():
    hopeless = design(FLEXIBLE, step_size=1e-2, noise_std=3.0, disturbance_bound=0.01)
    assert any("exceeds its bound" in text for text in hopeless.warnings)


def test_several_disturbances_have_their_own_bounds_rates_and_predictions():
    car = MODELS["car_in_crosswind"]
    found = design(car, step_size=2e-3, disturbance_bound=[2.0, 1e-2], disturbance_rate=[20.0, 0.1])
    assert found.predicted_bias.shape == found.error_bar.shape == found.certificate.at_sample.shape == (2,)
    with pytest.raises(ModelError, match="one for each disturbance"):
        design(car, step_size=2e-3, disturbance_rate=[1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"step_size": 0.0}, UsageError, "step size: expected a finite time > 0 s"),
        ({"step_size": float("nan")}, UsageError, "step size"),
        ({"step_size": 1e300}, UsageError, "step size: expected at most .* s for FlexibleJoint, received 1e.300 s"),
        ({"step_size": 1e-3, "disturbance_order": 4}, DesignError, "disturbance_order: expected 0, 1, 2 or 3"),
        ({"step_size": 1e-3, "noise_std": -1.0}, ModelError, "noise_std, motor_angle: expected a finite number ≥ 0"),
        ({"step_size": 1e-3, "noise_std": {"link_angel": 1.0}}, ModelError, "noise_std: .*did you mean 'link_angle'"),
        (
            {"step_size": 1e-3, "noise_std": [1.0, 2.0, 3.0]},
            ModelError,
            "noise_std: expected one number, or {name: number}",
        ),
        ({"noise_std": 1e-3}, UsageError, "noise_std: expected a step size with it"),
        ({"disturbance_order": 2}, UsageError, "disturbance_order: expected a step size"),
        ({"disturbance_bound": 2.0}, UsageError, "disturbance_bound: expected a step size"),
        ({"disturbance_rate": 0.0}, UsageError, r"disturbance_rate: .*received 0.0 and no step size.*--step-size"),
        (
            {"step_size": 1e-3, "disturbance_bound": 0.0},
            ModelError,
            "disturbance_bound: expected one finite number > 0",
        ),
        ({"step_size": 1e-3, "disturbance_bound": [1.0, 2.0]}, ModelError, "disturbance_bound: expected one finite"),
        (
            {"step_size": 1e-3, "disturbance_rate": float("inf")},
            ModelError,
            "disturbance_rate: expected one finite number ≥ 0",
        ),
    ],
)
def test_values_outside_their_range_end_in_one_line(arguments, error, message):
    with pytest.raises(error, match=message) as caught:
        design(FLEXIBLE, **arguments)
    assert "\n" not in str(caught.value)


def test_the_command_prints_json_with_the_names_of_the_contract(capsys):
    assert main(["design", "flexible_joint", "--step-size", "1e-3", "--noise-std", "1e-5", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert {"L", "W", "M", "poles", "riccati_residual", "K", "M_H", "filter_poles"} <= data.keys()
    assert np.shape(data["K"]) == (6, 2)
    assert data["certificate"]["loop_gain"] < 1.0


def test_the_bound_is_the_same_whatever_was_designed_before():
    first = design(FLEXIBLE, step_size=1e-3).certificate
    check(FLEXIBLE)
    again = design(FLEXIBLE, step_size=1e-3).certificate
    assert first.exists
    np.testing.assert_array_equal(again.states, first.states)


def test_without_a_declared_gamma_there_is_no_bound_and_one_line_says_so():
    silent = design(replace(FLEXIBLE, lipschitz=None), step_size=1e-3)
    assert "never more than" not in str(silent)
    assert "no bound: gamma, the largest slope of f, is not declared (lipschitz)" in str(silent).splitlines()
    assert np.all(np.isinf(silent.certificate.at_sample))


def test_each_output_has_a_noise_of_its_own_and_one_number_is_for_all(capsys):
    command = ["design", "flexible_joint", "--step-size", "1e-3", "--json"]
    found = {}
    for words in ("1e-5", "link_angle 1e-5 motor_angle 1e-5", "motor_angle 1e-2 link_angle 1e-5", "motor_angle 1e-2"):
        assert main([*command, "--noise-std", *words.split()]) == 0
        found[words] = json.loads(capsys.readouterr().out)
    one, two, mixed, partly = found.values()
    assert one == two
    assert mixed["noise_std"] == {"motor_angle": 1e-2, "link_angle": 1e-5}
    assert partly["noise_std"] == {"motor_angle": 1e-2, "link_angle": 0.0}  # the model's own
    # The motor's angle, with a thousand times the noise, gets less weight in the estimates of motor and load. It tells
    # next to nothing of the link beside the link's own sensor.
    for more, less in zip(np.abs(one["K"])[2:, 0], np.abs(mixed["K"])[2:, 0], strict=True):
        assert less < 0.5 * more


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("motor_angle", "--noise-std: expected a number, or pairs NAME NUMBER, received 'motor_angle'"),
        ("motor_angle 1 link_angle", "--noise-std: expected pairs NAME VALUE, received 3 words"),
        ("motor_angle much", "--noise-std motor_angle: expected a number"),
        ("motor_angel 1", "did you mean 'motor_angle'?"),
    ],
)
def test_noises_that_cannot_be_read_are_refused_in_one_line(capsys, words, message):
    assert main(["design", "flexible_joint", "--step-size", "1e-3", "--noise-std", *words.split()]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_the_command_takes_the_knowledge_of_the_disturbance(capsys):
    command = ["design", "flexible_joint", "--step-size", "1e-3", "--disturbance-order", "1", "--json"]
    rates = []
    for rate in ("3", "30"):
        assert main([*command, "--noise-std", "1e-4", "--disturbance-rate", rate, "--disturbance-bound", "2"]) == 0
        rates.append(json.loads(capsys.readouterr().out)["sampled_bandwidth"])
    assert rates[1] > rates[0]


def test_the_error_bars_are_those_that_the_observer_shows_once_they_have_settled():
    uncertain = {"joint_stiffness": 0.1, "gravity_torque": 1.0, "motor_damping": 0.1}
    told = replace(FLEXIBLE, parameter_std=uncertain, observer=replace(FLEXIBLE.observer, lag=0.05))
    known = {"step_size": 5e-3, "noise_std": 1e-4}
    plain, late = design(FLEXIBLE, **known), design(told, **known)
    # Without a lag the second one is at the sample, where there is no prediction.
    assert 0.5 * plain.error_bar[0] < plain.lagged_error_bar[0] < plain.error_bar[0]
    assert late.lagged_error_bar[0] < 0.9 * plain.lagged_error_bar[0]
    assert late.error_bar[0] > 1.02 * plain.error_bar[0]
    assert late.to_dict()["lag"] == 0.05
    assert "0.05 s before the sample" in str(late)
    eq, still = compile_model(FLEXIBLE), (0.0,) * 4
    observer = sampled_observer(eq, FLEXIBLE.parameter_values(), x_hat=still, noise_std=(1e-4, 1e-4))
    state = observer.init(still)
    for y in 1e-4 * np.random.default_rng(1).normal(size=(300, 2)):
        state, estimate = observer.step(state, (0.0,), y.tolist(), 5e-3)
    assert estimate.d_std[0] == pytest.approx(plain.error_bar[0], rel=0.1)


def test_the_bandwidth_counts_slopes_of_f_through_which_alone_an_output_shows_the_disturbance():
    slope = 0.25  # of the flow between the tanks at a level of 1
    tanks = Model(
        name="Tanks",
        states=["upper", "lower"],
        outputs=["lower"],
        disturbances=["inflow"],
        dynamics=lambda x, u, d, p: [
            d.inflow - 0.5 * sympy.sqrt(x.upper),
            0.5 * sympy.sqrt(x.upper) - 0.5 * sympy.sqrt(x.lower),
        ],
        ranges={"upper": (0.2, 2.0), "lower": (0.2, 2.0)},
        noise_std=1e-3,
        x0=[1.0, 1.0],
        xhat0=[1.0, 1.0],
    )
    found = design(tanks, step_size=0.01)
    # Where the disturbance's spectrum, seen through r + 2 integrations, meets the noise's.
    expected = (found.equivalent_pi * slope**2) ** (0.5 / (found.disturbance_order + 2))
    assert found.sampled_bandwidth == pytest.approx(expected, rel=1e-6)
