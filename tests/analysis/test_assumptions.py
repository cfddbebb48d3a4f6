"""The paper's assumptions (eqs. 2–4, 21), which method 1 needs: what passes, what fails, what the user is told."""

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import sympy
from hypothesis import given
from hypothesis import strategies as st

from ndob_fmu import Experiment, ObserverDefaults, SignalDefaults, build, check, design
from ndob_fmu.analysis.paper_checks import paper_rows
from ndob_fmu.codegen.compile_model import linear_part
from ndob_fmu.errors import AssumptionError, DesignError, ModelError, UsageError
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.design.minimum_phase import transmission_zeros
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.zeros import balance
from tests.helpers.problems import (
    BAD,
    MODELS,
    RANDOM,
    BadProblem,
    Problem,
    minimum_phase_systems,
    system_with_zeros,
    to_model,
)

FLEXIBLE_JOINT = MODELS["flexible_joint"]
METHOD_1 = ObserverDefaults(method=1)
random_problem = pytest.mark.parametrize("problem", RANDOM, ids=lambda problem: problem.name)
bad_problem = pytest.mark.parametrize("bad", BAD, ids=lambda bad: bad.name)


def failed(report, part="method 1"):
    return tuple(row.name for row in report.parts[part] if not row.passed)


def in_units(linear: LinearPart, states, inputs, outputs, rate=1.0) -> LinearPart:
    """The same plant with each state, unknown input, output and time measured in another unit."""
    return replace(
        linear,
        A=linear.A * states / states[:, None] / rate,
        B=linear.B / states[:, None] / rate,
        C=linear.C * states * outputs[:, None],
        G_f=linear.G_f * inputs[: linear.G_f.shape[1]] / states[:, None] / rate,
        G_d=linear.G_d * inputs[-linear.G_d.shape[1] :] / states[:, None] / rate,
    )


def without_slope(linear: LinearPart) -> Model:
    return to_model(linear, f=lambda x, u, p: [0] * linear.G_f.shape[1])


def units_of(problem: Problem, seed: int, decades: float):
    random = np.random.default_rng(seed)
    n, _, p, q = problem.shape
    return [10.0 ** random.uniform(-decades, decades, size) for size in (n, q, p)]


def assert_same_zeros(found, expected, tolerance):
    assert len(found) == len(expected)
    remaining = list(found)
    for zero in expected:
        nearest = min(remaining, key=lambda z: abs(z - zero))
        assert abs(nearest - zero) <= tolerance * abs(zero)
        remaining.remove(nearest)


# -- the paper's example


def test_the_papers_example_satisfies_every_assumption():
    report = check(FLEXIBLE_JOINT)
    assert report.passed
    assert report.require() is report
    assert report["minimum_phase"].measured == "no finite zeros"
    assert report["relative_degree"].values == {"f[0]": 2, "load_torque": 2}
    assert report["lipschitz"].values["gamma"] == pytest.approx(10.0, rel=1e-12)


def test_measuring_only_the_motor_angle_leaves_fewer_outputs_than_unknown_inputs():
    only_motor = replace(FLEXIBLE_JOINT, outputs=["motor_angle"], C=[[0, 0, 1, 0]])
    with pytest.raises(AssumptionError, match=r"expected p >= q \(eq\. 21\), received 1 outputs for 2 unknown inputs"):
        check(only_motor).require("method 1")


def test_measuring_the_rates_in_place_of_the_angles_hides_where_the_joint_is():
    rates = replace(FLEXIBLE_JOINT, outputs=["motor_rate", "link_rate"], C=[[0, 0, 0, 1], [0, 1, 0, 0]])
    report = check(rates)
    assert failed(report) == ("observable", "minimum_phase", "alpha_below_zeros")
    assert report["observable"].failure.endswith("1/s (link_angle, motor_angle)")
    np.testing.assert_allclose(report["minimum_phase"].values["zeros"], [0.0, 0.0], atol=1e-12)
    assert "no alpha is allowed" in report["alpha_below_zeros"].failure


# -- zeros


@random_problem
def test_zeros_of_square_and_tall_systems_in_dense_coordinates_are_found(problem):
    assert_same_zeros(transmission_zeros(problem.linear), problem.zeros, 1e-9)


@random_problem
def test_zeros_agree_with_two_random_squarings_down(problem):
    """For p > q the zeros are those of the finite eigenvalues that two different square pencils have in common."""
    linear = problem.linear
    n, _, p, q = problem.shape
    random = np.random.default_rng(0)
    spectra = []
    for _ in range(2):
        C = random.normal(size=(q, p)) @ linear.C
        pencil = np.block([[linear.A, linear.G], [C, np.zeros((q, q))]])
        values = scipy.linalg.eigvals(pencil, np.diag([1.0] * n + [0.0] * q))
        spectra.append(values[np.isfinite(values) & (abs(values) < 1e3)])
    common = [z for z in spectra[0] if np.min(abs(spectra[1] - z), initial=np.inf) < 1e-5]
    assert_same_zeros(transmission_zeros(linear), common, 1e-5)


@given(problem=minimum_phase_systems(), seed=st.integers(0, 10**6))
def test_zeros_keep_six_digits_whatever_the_units(problem, seed):
    rescaled = in_units(problem.linear, *units_of(problem, seed, decades=5.0))
    assert_same_zeros(transmission_zeros(rescaled), problem.zeros, 1e-6)


@given(problem=minimum_phase_systems(), seed=st.integers(0, 10**6))
def test_drawn_systems_satisfy_every_assumption_in_any_units(problem, seed):
    rescaled = in_units(problem.linear, *units_of(problem, seed, decades=5.0))
    rows = paper_rows(without_slope(rescaled), 1.5, None)
    assert all(row.passed for row in rows), rows


def test_a_faster_clock_scales_the_zeros_with_it():
    problem = system_with_zeros(relative_degrees=[3], zeros=[-2.0 + 3j], extra_outputs=1, inputs=3, seed=11)
    n, _, p, q = problem.shape
    milliseconds = in_units(problem.linear, np.ones(n), np.ones(q), np.ones(p), rate=1000.0)
    assert_same_zeros(1000.0 * transmission_zeros(milliseconds), problem.zeros, 1e-9)


def test_the_balanced_system_is_the_same_in_any_units_but_for_powers_of_two():
    problem = RANDOM[7]
    n, _, p, q = problem.shape
    linear = problem.linear
    scales = 10.0 ** np.random.default_rng(3).uniform(-7.0, 7.0, n + q + p)
    other = in_units(linear, scales[:n], scales[n : n + q], scales[n + q :])
    ours, theirs = balance(linear.A, linear.G, linear.C), balance(other.A, other.G, other.C)
    for own, foreign in ((ours.A, theirs.A), (ours.G, theirs.G), (ours.C, theirs.C)):
        seen = own != 0
        assert np.array_equal(seen, foreign != 0)
        assert np.max(abs(np.log2(np.abs(own[seen] / foreign[seen])))) <= 2.0 + 1e-9


def test_a_rounding_error_where_a_zero_should_be_does_not_choose_the_units():
    linear = linear_part(MODELS["three_tank"])
    soiled = linear.A.copy()
    soiled[0, 2] = 1e-24
    clean, other = (balance(A, linear.G, linear.C) for A in (linear.A, soiled))
    assert clean.rate / other.rate == pytest.approx(1.0, rel=0.51)
    states = (clean.states / clean.states[0]) / (other.states / other.states[0])
    assert np.all((states >= 0.5) & (states <= 2.0))


def test_infinite_zeros_of_high_relative_degree_are_not_taken_for_finite_ones():
    problem = system_with_zeros(relative_degrees=[3, 3], inputs=1, extra_outputs=1, seed=12)
    assert len(transmission_zeros(problem.linear)) == 0


def test_a_degenerate_system_has_no_zeros_to_return():
    twice = next(bad for bad in BAD if "unknown input that is twice" in bad.name)
    with pytest.raises(AssumptionError, match="expected 2 unknown inputs that the 4 outputs tell apart"):
        transmission_zeros(twice.linear)


def test_two_unknown_inputs_that_meet_in_one_state_are_degenerate_though_every_rank_is_full():
    meeting = Model(
        name="Meeting",
        states=["upper", "side", "meeting", "lower"],
        inputs=["u"],
        outputs=["meeting", "lower"],
        disturbances=["v", "w"],
        A=[[-2, 0, 0, 0], [0, -3, 0, 0], [1, 1, -1, 0], [0, 0, 1, -4]],
        B=[[0], [0], [1], [0]],
        C=[[0, 0, 1, 0], [0, 0, 0, 1]],
        G_d=[[1, 0], [0, 1], [0, 0], [0, 0]],
    )
    report = check(meeting)
    assert failed(report) == ("minimum_phase", "alpha_below_zeros")
    assert "normal rank 1 where 2 is needed" in report["minimum_phase"].failure


# -- what fails, and what is said


@bad_problem
def test_exactly_the_violated_assumptions_fail_and_the_culprit_is_named(bad: BadProblem):
    report = check(to_model(bad.linear, "Bad", observer=METHOD_1), alpha=0.5)
    assert failed(report) == bad.fails
    assert not report.passed
    with pytest.raises(AssumptionError) as caught:
        report.require("method 1")
    message = str(caught.value)
    assert message.startswith(f"Bad: {bad.fails[0]}: expected ")
    assert bad.says in message
    assert "likely cause: " in message
    assert "\n" not in message
    assert caught.value.exit_code == 1


@bad_problem
def test_the_verdict_does_not_depend_on_the_units(bad: BadProblem):
    n, p, q = len(bad.linear.A), len(bad.linear.C), bad.linear.G.shape[1]
    random = np.random.default_rng(5)
    rescaled = in_units(bad.linear, *(10.0 ** random.uniform(-5, 5, size) for size in (n, q, p)))
    assert failed(check(without_slope(rescaled), alpha=0.5)) == bad.fails


def test_a_hidden_pair_of_identical_chains_is_found_though_its_eigenvalues_are_defective():
    """The double eigenvalue of each chain is known to 1e-8 only; the structure shows the hidden one exactly."""
    chain = np.array([[-2.0, 1.0], [0.0, -2.0]])
    T = np.linalg.qr(np.random.default_rng(6).normal(size=(4, 4)))[0]
    linear = LinearPart(
        A=T.T @ scipy.linalg.block_diag(chain, chain) @ T,
        B=np.zeros((4, 0)),
        C=np.array([[1.0, 0.0, 0.0, 0.0]]) @ T,
        G_f=np.zeros((4, 0)),
        G_d=T.T @ np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]),
        matched=True,
    )
    row = check(to_model(linear))["observable"]
    assert not row.passed
    assert "hidden mode -2" in row.failure


def test_a_hidden_mode_at_the_end_of_a_chain_of_equal_ones_is_found():
    """Here the eigenvalue is triple, known to 1e-5, and the PBH matrix is regular at what rounding makes of it."""
    T = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
    linear = LinearPart(
        A=T.T @ np.array([[-2.0, 1.0, 0.0], [0.0, -2.0, 0.0], [1.0, 0.0, -2.0]]) @ T,
        B=np.zeros((3, 2)),
        C=np.array([[1.0, 0.0, 0.0]]) @ T,
        G_f=np.zeros((3, 0)),
        G_d=T.T @ np.array([[0.0], [1.0], [0.0]]),
        matched=True,
    )
    row = check(to_model(linear))["observable"]
    assert not row.passed
    assert "hidden mode -2 1/s" in row.failure


def test_an_oscillating_hidden_mode_is_named_once_with_the_states_that_carry_it():
    model = Model(
        name="Trailer",
        states=["position", "rate", "load_swing", "load_swing_rate"],
        outputs=["position"],
        disturbances=["push"],
        A=[[0, 1, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1], [1, 0, -9, 0]],
        C=[[1, 0, 0, 0]],
        G_d=[[0], [1], [0], [0]],
    )
    row = check(model)["observable"]
    assert row.failure == "hidden mode 0+3j 1/s (load_swing, load_swing_rate)"


# -- α


def test_alpha_must_stay_below_the_slowest_zero():
    model = to_model(RANDOM[0].linear)  # zeros −2 and −0.5
    assert check(model, alpha=0.499).holds("method 1")
    report = check(model, alpha=0.5)
    assert failed(report) == ("alpha_below_zeros",)
    assert report["alpha_below_zeros"].failure == "alpha = 0.5 1/s, zero at -0.5 1/s; at most 0.5 1/s is allowed"


def test_alpha_is_the_models_own_unless_given():
    assert check(FLEXIBLE_JOINT).alpha == FLEXIBLE_JOINT.observer.alpha
    assert check(MODELS["dc_motor"], alpha=501.0)["alpha_below_zeros"].passed is False
    assert check(MODELS["dc_motor"]).passed


@pytest.mark.parametrize("alpha", [0.0, -1.0, float("nan"), float("inf"), "fast"])
def test_an_alpha_that_is_no_positive_number_is_a_wrong_call_and_not_a_failed_check(alpha):
    with pytest.raises(UsageError, match=r"alpha of FlexibleJoint: expected a finite number > 0") as caught:
        check(FLEXIBLE_JOINT, alpha=alpha)
    assert caught.value.exit_code == 2


# -- relative degrees


@random_problem
def test_relative_degrees_count_the_integrations_to_the_nearest_output(problem):
    row = check(to_model(problem.linear), alpha=0.1)["relative_degree"]
    assert tuple(row.values.values()) == problem.relative_degrees
    assert row.passed


# -- γ


def one_state_model(f, **fields):
    standard = {"states": ["level", "rate"], "outputs": ["y"], "disturbances": ["d"]}
    standard |= {"A": [[0, 1], [0, 0]], "C": [[1, 0]], "G_d": [[0], [1]]}
    return Model(name="Slope", f=f, **(standard | fields))


def test_gamma_that_is_declared_too_small_fails_and_says_where_f_is_steeper():
    model = one_state_model(lambda x, u, p: [3.0 * sympy.sin(x.level - 2.0)], lipschitz=2.9)
    row = check(model)["lipschitz"]
    assert not row.passed
    assert row.values["gamma"] == pytest.approx(3.0, rel=1e-9)
    assert abs(np.cos(row.values["at"]["level"] - 2.0)) == pytest.approx(1.0, abs=1e-8)
    assert "where gamma = 2.9 is declared" in row.failure


def test_gamma_that_is_declared_exactly_passes():
    assert check(one_state_model(lambda x, u, p: [3.0 * sympy.sin(x.level)], lipschitz=3.0))["lipschitz"].passed


def test_friction_is_steepest_at_rest_however_narrow_the_transition():
    model = one_state_model(lambda x, u, p: [-2.0 * sympy.tanh(x.rate / 1e-5)], lipschitz=1.0)
    assert check(model)["lipschitz"].values["gamma"] == pytest.approx(2e5, rel=1e-9)


def test_a_steep_place_is_also_found_near_zero_and_where_another_state_is_large():
    near_zero = one_state_model(lambda x, u, p: [sympy.tanh((x.rate - 1e-3) / 1e-5)])
    assert check(near_zero)["lipschitz"].values["gamma"] == pytest.approx(1e5, rel=1e-6)
    loaded_friction = one_state_model(lambda x, u, p: [x.level * sympy.tanh(x.rate / 1e-6)])
    # Level and its start are known to ±1, and half of that span is added on each side.
    assert check(loaded_friction)["lipschitz"].values["gamma"] == pytest.approx(2e6, rel=1e-6)


def test_gamma_is_the_spectral_norm_over_all_states_and_channels():
    rows = np.array([[1.0, -2.0, 0.5], [3.0, 0.0, 1.0]])
    model = Model(
        name="Linear",
        states=["a", "b", "c"],
        outputs=["k", "l", "m", "n"],
        disturbances=["v", "w"],
        A=np.diag([-1.0, -2.0, -3.0]),
        C=np.vstack([np.eye(3), np.ones(3)]),
        G_d=np.eye(3)[:, :2],
        f=lambda x, u, p: list(sympy.Matrix(rows) * sympy.Matrix([x.a, x.b, x.c])),
    )
    assert check(model)["lipschitz"].values["gamma"] == pytest.approx(np.linalg.norm(rows, 2))


def test_gamma_is_that_of_the_ranges():
    """A polynomial has none without: its slope grows beyond all bounds."""
    model = one_state_model(lambda x, u, p: [x.level**2], lipschitz=10.0, ranges={"level": (-2.0, 5.0)})
    row = check(model)["lipschitz"]
    assert row.passed
    assert row.values["gamma"] == pytest.approx(10.0, rel=1e-9)
    assert row.measured.endswith("; in the ranges told")


def test_without_ranges_gamma_is_that_around_the_start_values():
    far = one_state_model(lambda x, u, p: [x.level**2], lipschitz=100.0, xhat0=[-7.0, 0.0], xhat0_std=[0.5, 1.0])
    row = check(far)["lipschitz"]
    # From the estimate's start with its error, −7.5, to x0 = 0; half of that is added on each side.
    assert row.values["gamma"] == pytest.approx(2.0 * (7.5 + 0.5 * 7.5), rel=1e-6)
    assert "around start values and default experiment, without ranges of level" in row.measured


def test_without_ranges_gamma_covers_what_the_default_experiment_visits():
    still, moved = (
        check(
            one_state_model(
                lambda x, u, p: [x.level**3 / 100],
                A=[[0, 1], [-1, -1]],
                disturbance=SignalDefaults(kind="constant", amplitude=amplitude),
                experiment=Experiment(stop_time=10.0),
            )
        )["lipschitz"].values["gamma"]
        for amplitude in (0.0, 3.0)
    )
    assert moved > 5.0 * still


def test_a_plant_is_not_looked_at_beyond_its_ranges():
    """1/gap has no slope at 0, where the ball would touch the magnet."""
    f = {"f": lambda x, u, p: [1 / x.level], "x0": [0.5, 0.0], "xhat0": [0.5, 0.0]}
    assert check(one_state_model(**f, ranges={"level": (0.1, 1.0)}))["lipschitz"].values["gamma"] == pytest.approx(
        100.0
    )


def test_inputs_take_part_in_the_search():
    model = one_state_model(
        lambda x, u, p: [u.thrust * sympy.sin(x.level)],
        inputs=["thrust"],
        B=[[0], [1]],
        lipschitz=5.0,
        ranges={"thrust": (-2.0, 10.0)},
    )
    row = check(model)["lipschitz"]
    assert row.values["gamma"] == pytest.approx(10.0, rel=1e-9)
    assert row.values["at"]["thrust"] == pytest.approx(10.0)


def test_without_a_declared_gamma_the_measured_one_informs():
    row = check(one_state_model(lambda x, u, p: [3.0 * sympy.sin(x.level)]))["lipschitz"]
    assert row.passed
    assert row.measured.startswith("largest slope 3 at level = 0; none declared; around start values")


@pytest.mark.parametrize(
    "f",
    [
        lambda x, u, p: [sympy.sign(x.rate)],
        lambda x, u, p: [sympy.sqrt(x.level)],
        lambda x, u, p: [sympy.sqrt(abs(x.level))],
    ],
    ids=["a switch", "a root of negative numbers", "a root that is vertical at zero"],
)
def test_an_f_with_no_lipschitz_constant_at_all_fails(f):
    row = check(one_state_model(f, x0=[1.0, 0.0], xhat0=[1.0, 0.0]))["lipschitz"]
    assert not row.passed
    assert "jumps or cannot be evaluated" in row.failure


def test_a_start_without_slopes_is_refused_before_the_observer_fails_there():
    with pytest.raises(DesignError, match=r"Slope, linearised at its start values: .*x0 is 0 where it is not told"):
        check(one_state_model(lambda x, u, p: [sympy.sqrt(x.level)]))


def test_the_start_of_the_plant_is_enough_to_linearise_there():
    assert check(one_state_model(lambda x, u, p: [sympy.sqrt(x.level)], x0=[1.0, 0.0]))["detectable"].passed


def test_a_linear_plant_has_no_gamma_to_check():
    assert check(one_state_model(None))["lipschitz"].measured == "no nonlinearity"


# -- parameters


def test_other_parameters_reach_the_matrices_and_the_slope_of_f():
    report = check(FLEXIBLE_JOINT, parameters={"gravity_torque": 12.0})
    assert failed(report) == ("lipschitz",)
    assert report["lipschitz"].values["gamma"] == pytest.approx(12.0)
    zero = check(MODELS["dc_motor"], parameters={"inductance": 1e-2})["minimum_phase"].values["zeros"]
    assert zero == pytest.approx([-100.0])


def test_a_joint_without_stiffness_still_passes_because_gravity_acts_as_an_unknown_input():
    assert check(FLEXIBLE_JOINT, parameters={"joint_stiffness": 0.0}).passed


def test_a_misspelt_parameter_is_refused_with_those_that_exist():
    with pytest.raises(
        ModelError,
        match=r"expected one of the parameters gravity_torque, joint_stiffness, motor_damping, received 'gravity'",
    ):
        check(FLEXIBLE_JOINT, parameters={"gravity": 12.0})


# -- the report


def test_the_table_is_ascii_aligned_and_marks_what_fails():
    text = str(check(to_model(BAD[0].linear, "Bad", observer=METHOD_1), alpha=0.5))
    assert text.isascii()
    head, *lines = text.splitlines()
    assert head == "Bad: 1 of 9 checks FAIL, alpha = 0.5 1/s"
    table = [line for line in lines if line.startswith("  ") and not line.lstrip().startswith(">")]
    assert [line[2:6].strip() for line in table].count("FAIL") == 1
    requirement = next(line for line in table if "p >= q" in line).index("p >= q")
    assert all(line[requirement - 2 : requirement] == "  " and line[requirement] != " " for line in table)
    assert any("mode -7.5 1/s (x7)" in line for line in lines)


def test_the_json_form_carries_every_row_with_its_numbers():
    data = json.loads(json.dumps(check(to_model(RANDOM[1].linear), alpha=1.0).to_dict(), allow_nan=False))
    rows = {row["name"]: row for row in data["rows"]}
    assert data["passed"] is True
    assert [rows[name]["part"] for name in ("disturbance_zeros", "minimum_phase")] == ["method 2", "method 1"]
    assert list(rows) == [
        "detectable",
        "disturbance_zeros",
        "error_bars",
        "pace",
        "outputs_at_least_unknown_inputs",
        "rank_C",
        "rank_G",
        "observable",
        "controllable",
        "relative_degree",
        "minimum_phase",
        "alpha_below_zeros",
        "lipschitz",
    ]
    np.testing.assert_allclose(rows["minimum_phase"]["values"]["zeros"], [[-1.5, -4.0], [-1.5, 4.0]])
    assert rows["alpha_below_zeros"]["values"]["largest_allowed"] == pytest.approx(1.5)


def test_the_json_form_of_a_failed_report_names_the_cause():
    report = check(to_model(BAD[3].linear, observer=METHOD_1), alpha=1.0)
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    row = next(row for row in data["rows"] if row["part"] == data["decides"])
    assert (data["passed"], row["passed"], row["failure"]) == (False, False, "1 outputs for 2 unknown inputs")
    assert row["likely_cause"]


@pytest.mark.parametrize("command", [build, check, design])
def test_a_path_in_place_of_a_model_is_refused_with_the_function_that_reads_it(command):
    with pytest.raises(UsageError, match=r"expected a Model, received 'plant.py'; likely cause: `load_model"):
        command("plant.py")


def test_offsets_and_estimated_parameters_have_rows_that_inform():
    names = [row.name for row in check(FLEXIBLE_JOINT).rows]
    assert "offsets" not in names
    assert "estimated_parameters" not in names
    told = replace(
        FLEXIBLE_JOINT,
        bias_std={"motor_angle": 0.01},
        parameter_std={"joint_stiffness": 0.1, "motor_damping": 0.1},
        observer=replace(FLEXIBLE_JOINT.observer, estimate_parameters=True),
    )
    report = check(told)
    assert report.passed
    assert report["offsets"].values == {"motor_angle": True}
    assert report["estimated_parameters"].values == {"joint_stiffness": True, "motor_damping": False}
    assert "motor_damping: NOT told from a disturbance" in str(report)
    both = check(replace(FLEXIBLE_JOINT, bias_std=0.01))
    assert both["offsets"].values == {"motor_angle": False, "link_angle": False}
