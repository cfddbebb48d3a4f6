"""The paper's gain: L of eq. (7), the two lemmas, W of eq. (9), and M that repairs what W leaves at DC."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu import design
from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.errors import AssumptionError, DesignError, UsageError
from ndob_fmu.runtime.design.gains import paper_gains
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.step.paper_observer import paper_observer
from tests.helpers.problems import BAD, MODELS, RANDOM, to_model

FLEXIBLE_JOINT = MODELS["flexible_joint"]
JOINT = linear_part(FLEXIBLE_JOINT)
PIS = 10.0 ** np.arange(0, 17)
TALL_JOINT = replace(JOINT, G_f=JOINT.G_d, matched=True)  # q = 1 < p = 2: both angles for the load torque alone
problems = pytest.mark.parametrize("problem", RANDOM, ids=lambda problem: problem.name)


def fitted_slope(x, y):
    return np.polyfit(np.log10(x), np.log10(y), 1)[0]


def dc_gain_of(linear, gains):
    """C (L C − A)⁻¹ G: the output error per constant unknown input."""
    return linear.C @ np.linalg.solve(gains.L @ linear.C - linear.A, linear.G)


# -- the paper's example


def test_the_printed_l_at_pi_1e12_is_reproduced_in_all_printed_digits():
    """§3; an entry like 1.4162e3 is printed with five digits, so it is right to half of the last one."""
    printed = [
        [7.0711e-4, 1.4162e3],
        [1.0004, 1.0014e6],
        [1.4152e3, 7.0711e-4],
        [1.0000e6, 1.0004],
    ]
    unit = 10.0 ** (np.floor(np.log10(printed)) - 4)
    assert np.all(np.abs(design(FLEXIBLE_JOINT, pi=1e12, alpha=1.0).L - printed) <= 0.5 * unit)


def test_without_the_motor_damping_the_printed_l_cannot_be_had():
    """The damping decides the fifth digit of two entries: this is how the paper's garbled A₄₄ = −1 is known."""
    undamped = design(FLEXIBLE_JOINT, pi=1e12, alpha=1.0, parameters={"motor_damping": 0.0}).L
    assert undamped[2, 0] == pytest.approx(1416.2, abs=0.05)
    assert abs(undamped[2, 0] - 1415.2) > 0.5


# -- Lemma 1: Q(π)/π → 0


def test_lemma_1_q_over_pi_of_the_joint_falls_at_every_decade_and_in_the_end_like_pi_to_the_minus_a_quarter():
    sizes = [np.linalg.norm(paper_gains(JOINT, pi=pi, alpha=1.0).riccati.Q, 2) / pi for pi in PIS]
    assert np.all(np.diff(sizes) < 0)
    assert fitted_slope(PIS[-7:], sizes[-7:]) == pytest.approx(-1 / 4, abs=0.001)


@problems
def test_lemmas_1_and_2_hold_at_the_rate_that_the_largest_relative_degree_r_sets(problem):
    """‖Q‖/π and ‖L/√π − G W‖ both fall like π^(−1/(2r)), square or tall: no artificial expansion is needed."""
    linear = problem.linear
    gains = [paper_gains(linear, pi=pi, alpha=0.4) for pi in PIS]
    rate = -1.0 / (2 * max(problem.relative_degrees))
    q_over_pi = [np.linalg.norm(g.riccati.Q, 2) / pi for g, pi in zip(gains, PIS, strict=True)]
    distance = [np.linalg.norm(g.L / np.sqrt(pi) - linear.G @ g.W) for g, pi in zip(gains, PIS, strict=True)]
    for falling in (q_over_pi, distance):
        assert np.all(np.diff(falling) < 0)
        assert fitted_slope(PIS[-5:], falling[-5:]) == pytest.approx(rate, abs=0.005)


@problems
@pytest.mark.parametrize("pi", [1e-2, 1e4, 1e12])
def test_w_has_orthonormal_rows_and_no_other_such_matrix_is_nearer_to_the_limit_of_remark_2(problem, pi):
    linear = problem.linear
    _, _, p, q = problem.shape
    gains = paper_gains(linear, pi=pi, alpha=0.4)
    assert gains.W.shape == (q, p)
    np.testing.assert_allclose(gains.W @ gains.W.T, np.eye(q), atol=1e-13)
    target = np.linalg.solve(linear.G.T @ linear.G, linear.G.T @ gains.L)  # (GᵀG)⁻¹ Gᵀ L
    # The polar factor is the one with target = S W, S symmetric and positive definite.
    S = target @ gains.W.T
    np.testing.assert_allclose(S, S.T, atol=1e-8 * np.linalg.norm(S))
    assert np.linalg.eigvalsh(S + S.T).min() > 0


def test_l_is_near_root_pi_g_w_at_pi_1e12_for_the_joint_with_one_or_two_unknown_inputs():
    for linear, distance in ((JOINT, 2.451e-3), (TALL_JOINT, 1.414e-3)):
        gains = paper_gains(linear, pi=1e12, alpha=1.0)
        assert np.linalg.norm(gains.L / 1e6 - linear.G @ gains.W) == pytest.approx(distance, rel=1e-3)


# -- DC: M is exact, W is not


@problems
@pytest.mark.parametrize("pi", [1e-2, 1e4, 1e12])
def test_m_returns_a_constant_unknown_input_exactly_at_any_pi(problem, pi):
    """M C (L C − A)⁻¹ G = I, a left inverse where p > q."""
    linear = problem.linear
    gains = paper_gains(linear, pi=pi, alpha=0.4)
    assert gains.M.shape == problem.shape[:1:-1]
    dc = dc_gain_of(linear, gains)
    np.testing.assert_allclose(gains.M @ dc, np.eye(len(gains.M)), atol=1e-13)


@problems
def test_root_pi_w_comes_to_m_as_pi_rises_where_the_system_is_square(problem):
    linear = problem.linear
    _, _, p, q = problem.shape
    gains = [paper_gains(linear, pi=pi, alpha=0.4) for pi in PIS]
    bias = [
        np.linalg.norm(np.sqrt(pi) * g.W @ dc_gain_of(linear, g) - np.eye(q)) for g, pi in zip(gains, PIS, strict=True)
    ]
    rate = -1.0 / (2 * max(problem.relative_degrees))
    assert fitted_slope(PIS[-5:], bias[-5:]) <= rate + 0.005
    if p == q:
        distance = [np.linalg.norm(g.W - g.M / np.sqrt(pi)) for g, pi in zip(gains, PIS, strict=True)]
        assert fitted_slope(PIS[-5:], distance[-5:]) <= rate + 0.005


def test_w_shows_a_constant_load_of_the_joint_root_2_alpha_over_pi_to_a_quarter_too_small():
    """1 − d̂/d ≈ √2 α/π^{1/4}: −0.14 % and d̂ = 1.99717 for d = 2 in the example."""
    for pi, alpha, within in ((1e12, 1.0, 1e-3), (1e16, 1.0, 1e-4), (1e16, 3.0, 3e-4)):
        bias = 1.0 - design(FLEXIBLE_JOINT, pi=pi, alpha=alpha).dc_gain[0]
        assert bias == pytest.approx(np.sqrt(2.0) * alpha / pi**0.25, rel=within)
    assert 2.0 * design(FLEXIBLE_JOINT, pi=1e12, alpha=1.0).dc_gain[0] == pytest.approx(1.99717, abs=5e-6)


# -- what a design tells its user


@pytest.mark.parametrize("problem", RANDOM[4:8], ids=lambda problem: problem.name)
def test_a_design_is_the_gain_at_its_pi_and_alpha_and_its_poles_are_those_of_a_minus_l_c(problem):
    model = to_model(problem.linear)
    linear = linear_part(model)
    report, gains = design(model, pi=1e6, alpha=0.4), paper_gains(linear, pi=1e6, alpha=0.4)
    for name in ("L", "W", "M"):
        np.testing.assert_array_equal(getattr(report, name), getattr(gains, name))
    np.testing.assert_array_equal(report.Q, gains.riccati.Q)
    poles = np.sort_complex(np.linalg.eigvals(linear.A - report.L @ linear.C))
    np.testing.assert_allclose(report.poles, poles, rtol=1e-9)
    assert np.all(report.poles.real < -0.4)
    assert report.bandwidth == np.max(np.abs(report.poles))
    assert report.riccati_residual == gains.riccati.residual < 1e-8


def test_the_bandwidth_of_the_joint_is_pi_to_a_quarter():
    assert design(FLEXIBLE_JOINT, pi=1e12, alpha=1.0).bandwidth == pytest.approx(1000.0, rel=2e-3)


@pytest.mark.parametrize("problem", RANDOM[4:8], ids=lambda problem: problem.name)
def test_the_noise_gain_is_the_spread_of_d_hat_under_white_noise_in_the_samples(problem):
    """d̂ of the observer itself, eq. (23), at the true state and under 8000 noisy samples."""
    model = to_model(problem.linear)
    report = design(model, pi=1e6, alpha=0.4)
    observer = paper_observer(compile_model(model), (), PiSchedule(1.0, 1e6, 0.0), alpha=0.4)
    n, _, p, _ = problem.shape
    state = observer.init(np.ones(n))
    y = problem.linear.C @ np.ones(n)
    random = np.random.default_rng(0)
    noise = [observer.estimate(state, y + 1e-3 * random.normal(size=p)).d_hat for _ in range(8_000)]
    np.testing.assert_allclose(np.std(noise, axis=0), 1e-3 * report.noise_gain, rtol=0.03)


@pytest.mark.parametrize("problem", RANDOM[4:8], ids=lambda problem: problem.name)
def test_the_dc_gain_is_where_d_hat_of_the_linear_observer_settles(problem):
    """From x̃' = (A − L C) x̃ + G_d d at rest."""
    linear = problem.linear
    report = design(to_model(linear), pi=1e4, alpha=0.4)
    at_rest = np.linalg.solve(report.L @ linear.C - linear.A, linear.G_d)
    d_hat = 1e2 * (report.W @ linear.C @ at_rest)[-linear.G_d.shape[1] :]
    np.testing.assert_allclose(report.dc_gain, np.diag(d_hat), rtol=1e-9)


def test_a_design_becomes_json_and_comes_back_with_every_digit():
    report = design(to_model(RANDOM[6].linear), pi=1e6, alpha=0.4)
    back = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    for name in ("L", "W", "M", "Q", "dc_gain", "noise_gain"):
        np.testing.assert_array_equal(np.array(back[name]), getattr(report, name))
    np.testing.assert_array_equal([complex(*pole) for pole in back["poles"]], report.poles)
    assert (back["pi"], back["alpha"]) == (1e6, 0.4)
    assert back["riccati_residual"] == report.riccati_residual
    assert back["model"] == "Random"


def test_a_design_can_be_read_as_text():
    text = str(design(FLEXIBLE_JOINT, pi=1e12, alpha=1.0))
    for part in ("FlexibleJoint", "pi = 1e+12", "alpha = 1", "1.4162e+03", "load_torque", "0.99859"):
        assert part in text


def test_pi_and_alpha_are_the_models_unless_given():
    assert (design(FLEXIBLE_JOINT).pi, design(FLEXIBLE_JOINT).alpha) == (1e12, 1.0)
    assert (design(FLEXIBLE_JOINT, pi=1e4).pi, design(FLEXIBLE_JOINT, alpha=2.0).alpha) == (1e4, 2.0)


def test_other_physical_parameters_give_another_gain():
    changed = design(FLEXIBLE_JOINT, pi=1e6, parameters={"joint_stiffness": 50.0})
    linear = linear_part(FLEXIBLE_JOINT, {"joint_stiffness": 50.0})
    np.testing.assert_array_equal(changed.L, paper_gains(linear, pi=1e6, alpha=1.0).L)
    assert np.max(np.abs(changed.L - design(FLEXIBLE_JOINT, pi=1e6).L)) > 1.0


# -- refused


@pytest.mark.parametrize("pi", [0.0, -1.0, np.nan, np.inf])
def test_a_pi_that_is_not_a_finite_number_above_zero_is_refused(pi):
    with pytest.raises(UsageError, match="pi: expected a finite number > 0") as refused:
        design(FLEXIBLE_JOINT, pi=pi)
    assert refused.value.exit_code == 2


@pytest.mark.parametrize("alpha", [0.0, -1.0, np.nan, np.inf])
def test_an_alpha_that_is_not_a_finite_number_above_zero_is_refused(alpha):
    with pytest.raises((UsageError, AssumptionError), match="alpha"):
        design(FLEXIBLE_JOINT, alpha=alpha)


def test_an_alpha_beyond_the_zeros_is_refused():
    """Theorem 1 needs 0 < α < min(−Re z); here the zeros are −2 and −0.5."""
    model = to_model(RANDOM[0].linear)
    design(model, pi=1e4, alpha=0.49)
    with pytest.raises(AssumptionError, match="alpha") as refused:
        design(model, pi=1e4, alpha=0.51)
    assert refused.value.exit_code == 1


@pytest.mark.parametrize("bad", BAD, ids=lambda bad: bad.name)
def test_a_system_that_violates_an_assumption_is_refused_before_anything_is_designed(bad):
    with pytest.raises(AssumptionError):
        design(to_model(bad.linear), pi=1e4, alpha=0.1)


def test_a_pi_beyond_trust_is_refused_whatever_the_assumptions_say():
    with pytest.raises(DesignError, match="too large a pi") as refused:
        design(to_model(RANDOM[3].linear), pi=1e36, alpha=0.4)
    assert refused.value.exit_code == 1
