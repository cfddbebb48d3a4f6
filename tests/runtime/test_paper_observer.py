"""The paper's observer, eqs. (5)–(6) and (22)–(23), over sampled measurements: what it converges to, and its example.

The independent answers here are the continuous system of plant and observer, solved by SciPy, and equilibria.
"""

import functools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import solve_ivp
from scipy.optimize import root

from ndob_fmu import design
from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.errors import AssumptionError, DesignError
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.design.gains import orthogonal_factor
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.numerics.hold import History
from ndob_fmu.runtime.numerics.riccati import solve_riccati
from ndob_fmu.runtime.step.paper_observer import paper_observer
from tests.helpers.problems import MODELS, RANDOM, to_model

JOINT = MODELS["flexible_joint"]
LINEAR = linear_part(JOINT)
ALPHA, TRUTH, WRONG, LOAD, TORQUE = 1.0, np.ones(4), -np.ones(4), 2.0, 0.5


def joint_observer(schedule, **options):
    return paper_observer(compile_model(JOINT), JOINT.parameter_values(), schedule, alpha=ALPHA, **options)


def joint_plant(load=LOAD):
    return Plant(compile_model(JOINT), JOINT.parameter_values(), [Generator(KINDS["constant"], load)])


def coupled(observer, plant, steps, *, x_hat=WRONG, torque=0.0, lost=lambda k: False):
    """Step observer and plant side by side, from the plant's sample at the start of each step; both start at t = 0.

    Returns columns: t at the end of the step, d̂ for it, d̂ at the sample, valid, and ‖x̂ − x‖ and x̂ for the end.
    """
    state, own, rows = plant.init(TRUTH, 0.0), observer.init(x_hat), []
    for k, H in enumerate(steps):
        y = LINEAR.C @ state.x
        own, estimate = observer.step(own, (torque,), np.array([y[0], np.nan]) if lost(k) else y, H)
        state = plant.step(state, (torque,), (0.0,), state.t + H)
        error = np.linalg.norm(np.subtract(estimate.x_hat, state.x))
        rows.append([state.t, estimate.d_hat[0], estimate.d_at_sample[0], estimate.valid, error, *estimate.x_hat])
    return np.array(rows)


def exact_gain(pi):
    return solve_riccati(LINEAR.A, LINEAR.C, LINEAR.G, pi=pi, alpha=ALPHA).Q @ LINEAR.C.T


def scipys_gain(pi):
    Q = scipy.linalg.solve_continuous_are(
        (LINEAR.A + ALPHA * np.eye(4)).T, LINEAR.C.T, pi * LINEAR.G @ LINEAR.G.T, np.eye(2)
    )
    return Q @ LINEAR.C.T


def continuous(pi_of, gain, times, edges):
    """Return d̂ (len(times),) and x̂ (len(times),4) of plant and observer as one differential equation, y continuous.

    ẋ = A x + B u + G₁ f(x) + G₂ d,  x̂' = A x̂ + B u + L(π(t)) (y − C x̂) + G₁ f(x̂),  d̂ = √π [0 1] W (y − C x̂)
    """

    def derivatives(t, z):
        x, x_hat = z[:4], z[4:]
        known, known_hat = (LINEAR.B[:, 0] * TORQUE - LINEAR.G_f[:, 0] * 10.0 * np.sin(v[0]) for v in (x, x_hat))
        output_error = LINEAR.C @ (x - x_hat)
        return [
            *(LINEAR.A @ x + known + LINEAR.G_d[:, 0] * LOAD),
            *(LINEAR.A @ x_hat + known_hat + gain(pi_of(t)) @ output_error),
        ]

    z, d_hats, x_hats = np.concatenate([TRUTH, WRONG]), [], []
    for begin, end in pairwise(edges):
        own = times[(times > begin) & (times <= end)]
        solution = solve_ivp(
            derivatives,
            (begin, end),
            z,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            t_eval=np.union1d(own, [end]),
        )
        z = solution.y[:, -1]
        for t, column in zip(solution.t, solution.y.T, strict=True):
            if t in own:
                pi = pi_of(t)
                W = orthogonal_factor(LINEAR, gain(pi))
                d_hats.append(np.sqrt(pi) * (W @ LINEAR.C @ (column[:4] - column[4:]))[1])
                x_hats.append(column[4:])
    return np.array(d_hats), np.array(x_hats)


@functools.cache
def continuous_d_hat(schedule, times):
    """With the table's gains while π moves; with SciPy's solution of eq. (24) where it does not."""
    if schedule.ramp_time:
        table, edges = joint_observer(schedule).gains.table, [0.0, schedule.ramp_time, times[-1]]
        return continuous(
            lambda t: np.exp(schedule.log_pi(t)), lambda pi: table.gain(np.log(pi)), np.array(times), edges
        )[0]
    L = scipys_gain(schedule.pi_end)
    return continuous(lambda t: schedule.pi_end, lambda pi: L, np.array(times), [0.0, times[-1]])[0]


def at(times, rows):
    found = rows[np.searchsorted(rows[:, 0], times - 1e-9)]
    np.testing.assert_allclose(found[:, 0], times, rtol=0, atol=1e-9)
    return found


# -- (a) it converges to the continuous observer, with the order of the hold


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("ramp_time", [0.0, 1.5], ids=["constant pi", "pi on its ramp until 1.5 s"])
def test_d_hat_converges_to_that_of_the_continuous_observer_with_order_k_plus_1(degree, ramp_time):
    """y continued by a polynomial of degree k is wrong by O(H^{k+1}), and so is d̂; the window ends after the ramp."""
    times, schedule = np.linspace(1.2, 2.0, 21), PiSchedule(1.0, 1e5 if ramp_time else 1e4, ramp_time)
    d_hats = continuous_d_hat(schedule, tuple(times))
    step_sizes = np.array([4e-3, 2e-3, 1e-3])
    errors = []
    for H in step_sizes:
        rows = coupled(joint_observer(schedule, hold_degree=degree), joint_plant(), [H] * round(2.0 / H), torque=TORQUE)
        errors.append(np.max(np.abs(at(times, rows)[:, 1] - d_hats)))
    assert np.polyfit(np.log(step_sizes), np.log(errors), 1)[0] == pytest.approx(degree + 1.0, abs=0.05)


def test_steps_of_varying_length_give_the_same_estimate():
    schedule = PiSchedule(1.0, 1e5, 1.5)
    gain = joint_observer(schedule).gains.table.gain
    d_hats, x_hats = continuous(
        lambda t: np.exp(schedule.log_pi(t)), lambda pi: gain(np.log(pi)), np.array([2.0]), [0, 1.5, 2]
    )
    steps = np.random.default_rng(0).uniform(0.3e-3, 1.7e-3, 2000)
    last = coupled(joint_observer(schedule), joint_plant(), 2.0 * steps / steps.sum(), torque=TORQUE)[-1]
    assert last[0] == pytest.approx(2.0, abs=1e-12)
    assert last[1] == pytest.approx(d_hats[-1], abs=1e-6)
    np.testing.assert_allclose(last[5:], x_hats[-1], rtol=0, atol=1e-6)


def test_the_estimate_at_the_sample_is_that_of_the_sample():
    """d̂ = √π [0 1] W (y − C x̂), eq. (23), for the sample that the step began with, with x̂ predicted for it."""
    schedule, state = PiSchedule(1.0, 1e6, 2.0), joint_plant().init(TRUTH, 0.0)
    observer, plant = joint_observer(schedule), joint_plant()
    own = observer.init(WRONG)
    for k in range(300):
        y, x_hat = LINEAR.C @ state.x, own.x_hat
        own, estimate = observer.step(own, (TORQUE,), y, 0.01)
        pi = np.exp(schedule.log_pi(k * 0.01))
        W = orthogonal_factor(LINEAR, exact_gain(pi))
        np.testing.assert_allclose(estimate.residual, y - LINEAR.C @ x_hat, rtol=0, atol=1e-15)
        assert estimate.d_at_sample[0] == pytest.approx(
            np.sqrt(pi) * (W @ (y - LINEAR.C @ x_hat))[1], rel=1e-4, abs=1e-9
        )
        state = plant.step(state, (TORQUE,), (0.0,), (k + 1) * 0.01)


def test_the_error_bar_is_the_noise_times_its_gain_and_what_w_leaves_of_the_largest_constant_load():
    """hypot(√π ‖w‖ σ, (1 − dc gain) D₀), both factors as `design` reports them, at the start and at the end of π."""
    observer = joint_observer(PiSchedule(1e4, 1e8, 0.1), noise_std=(1e-5, 1e-5), disturbance_bound=(5.0,))
    state = observer.init(WRONG)
    error_bars = [observer.estimate(state, (0.0, 0.0)).d_std]
    for _ in range(20):
        state, estimate = observer.step(state, (0.0,), (0.0, 0.0), 0.01)
    error_bars.append(estimate.d_std)
    for pi, d_std in zip((1e4, 1e8), error_bars, strict=True):
        report = design(JOINT, pi=pi, alpha=ALPHA)
        expected = np.hypot(1e-5 * report.noise_gain, (1.0 - report.dc_gain) * 5.0)
        np.testing.assert_allclose(d_std, expected, rtol=1e-9)


# -- (b) started at the truth it stays there


def test_at_rest_the_estimate_stays_at_the_truth_to_the_last_bit():
    observer = joint_observer(PiSchedule(1.0, 1e12, 0.5))
    state = observer.init(np.zeros(4))
    for _ in range(1000):
        state, estimate = observer.step(state, (0.0,), (0.0, 0.0), 1e-3)
        assert not np.any(estimate.x_hat)
        assert not np.any(estimate.d_hat)


@pytest.mark.parametrize(("pi", "within"), [(1e4, 1e-11), (1e8, 1e-9)])
def test_where_the_output_is_a_quadratic_polynomial_the_estimate_stays_at_the_truth_to_rounding(pi, within):
    """Two integrators under a constant input, and three samples known; d̂ rounds √π times as much as x̂."""
    model = Model(
        name="Cart",
        states=["place", "speed"],
        inputs=["force"],
        outputs=["place"],
        disturbances=["push"],
        A=[[0, 1], [0, 0]],
        B=[[0], [1]],
        C=[[1, 0]],
        G_d=[[0], [1]],
    )
    observer = paper_observer(compile_model(model), (), PiSchedule(1.0, pi, 0.0), alpha=0.4)
    H, force = 0.01, 0.7

    def truth(t):
        return np.array([1.0 + 0.5 * t + force * t * t / 2.0, 0.5 + force * t])

    past = History(ages=np.array([H, 2.0 * H]), samples=np.array([truth(-H)[:1], truth(-2.0 * H)[:1]]))
    state = replace(observer.init(truth(0.0)), history=past)
    for k in range(300):
        state, estimate = observer.step(state, (force,), truth(k * H)[:1], H)
        np.testing.assert_allclose(estimate.x_hat, truth((k + 1) * H), rtol=0, atol=within)
        assert abs(estimate.d_hat[0]) < within * np.sqrt(pi)


def test_from_the_true_state_of_the_joint_the_errors_fall_like_h_cubed():
    step_sizes, errors = np.array([8e-3, 4e-3, 2e-3, 1e-3]), []
    for H in step_sizes:
        observer = joint_observer(PiSchedule(1.0, 1e6, 0.0))
        rows = coupled(observer, joint_plant(0.0), [H] * round(2.0 / H), x_hat=TRUTH)
        late = rows[rows[:, 0] > 1.0]
        errors.append([np.max(late[:, 4]), np.max(np.abs(late[:, 1]))])
    slopes = np.polyfit(np.log(step_sizes), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, 3.0, atol=0.25)
    assert errors[-1][1] < 1e-5


# -- (c) the paper's example


@pytest.fixture(scope="module")
def example():
    """§3: x(0) = 1, x̂(0) = −1, d = 2, α = 1, π from 1 to 1e12 in 10 s; plain Python at H = 1 ms."""
    return coupled(joint_observer(PiSchedule(1.0, 1e12, 10.0)), joint_plant(), [1e-3] * 14_000)


def test_the_example_finds_the_load_within_2_percent_from_about_4_s_on(example):
    t, error = example[:, 0], np.abs(example[:, 1] - 2.0)
    last_outside = t[error > 0.04][-1]
    assert 4.0 < last_outside < 4.6
    assert np.all(error[t >= 12.0] <= 0.005)


def test_the_example_ends_with_the_bias_of_w_and_nothing_else(example):
    """d̂ = 1.99717 and ‖x̃‖ = 2.83e-3, as the continuous observer has them."""
    assert example[-1, 2] == pytest.approx(1.99717, abs=3e-5)
    assert example[-1, 4] == pytest.approx(2.83e-3, rel=0.01)


def test_with_the_schedule_the_example_does_not_peak(example):
    assert np.max(np.abs(example[:, 1:3])) < 2.5
    assert np.max(example[:, 4]) < 4.1


def test_without_the_schedule_the_same_example_peaks_a_hundred_thousandfold():
    rows = coupled(joint_observer(PiSchedule(1.0, 1e12, 0.0)), joint_plant(), [1e-3] * 100)
    assert np.max(np.abs(rows[:, 2])) > 1e6
    assert np.max(np.abs(rows[:, 1])) > 1e5
    assert np.max(rows[:, 4]) > 1e3
    assert np.all(np.abs(rows[50:, 1] - 2.0) < 0.04)


@pytest.mark.parametrize(("degree", "at_least", "at_most"), [(0, 50.0, 2000.0), (1, 0.05, 2.0), (2, 0.0, 0.02)])
def test_holding_the_last_sample_is_useless_at_pi_1e12_and_a_quadratic_is_not(degree, at_least, at_most):
    """At H = 1 ms; what is left beside the bias of W."""
    observer = joint_observer(PiSchedule(1.0, 1e12, 0.5), hold_degree=degree)
    rows = coupled(observer, joint_plant(), [1e-3] * 1500)
    late = rows[rows[:, 0] > 1.0, 1]
    assert at_least <= np.max(np.abs(late - 1.99717)) <= at_most


# -- (d) a step is a function of its arguments


def test_a_step_gives_the_same_bits_whatever_was_stepped_before_and_changes_nothing():
    observer, steps = joint_observer(PiSchedule(1.0, 1e6, 0.1)), []
    state = observer.init(WRONG)
    samples = np.random.default_rng(0).normal(size=(40, 2))
    for k, y in enumerate(samples):
        H = 0.01 if k % 3 else 0.02
        before = (
            state,
            state.x_hat.copy(),
            state.history.samples.copy(),
            state.history.ages.copy(),
            state.w_hat.copy(),
        )
        state, estimate = observer.step(state, (0.1 * k,), y, H)
        steps.append((before, k, y, H, state, estimate))
    for before, k, y, H, after, estimate in reversed(steps):
        start = before[0]
        for array, copy in zip(
            (start.x_hat, start.history.samples, start.history.ages, start.w_hat), before[1:], strict=True
        ):
            np.testing.assert_array_equal(array, copy)
        again, repeated = observer.step(start, (0.1 * k,), y, H)
        assert again.elapsed == after.elapsed
        for name in ("x_hat", "w_hat", "u"):
            np.testing.assert_array_equal(getattr(again, name), getattr(after, name))
        for name in ("x_hat", "d_hat", "d_at_sample", "d_std", "residual"):
            np.testing.assert_array_equal(getattr(repeated, name), getattr(estimate, name))


# -- (e) bad samples


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_sample_with_one_bad_output_is_not_used_at_all_and_said_to_be_invalid(bad):
    observer = joint_observer(PiSchedule(1.0, 1e6, 0.0))
    state, _ = observer.step(observer.init(WRONG), (0.0,), (0.3, -0.2), 0.01)
    partly, estimate = observer.step(state, (0.0,), (bad, 0.1), 0.01)
    wholly, same = observer.step(state, (0.0,), (7.0, bad), 0.01)
    assert not estimate.valid
    np.testing.assert_array_equal(estimate.residual, [0.0, 0.0])
    np.testing.assert_array_equal(estimate.x_hat, same.x_hat)
    np.testing.assert_array_equal(estimate.d_hat, observer.linear.selector @ state.w_hat)
    np.testing.assert_array_equal(partly.history.samples, wholly.history.samples)
    assert np.all(np.isfinite(estimate.x_hat))
    assert observer.step(partly, (0.0,), (0.3, -0.2), 0.01)[1].valid


def test_over_a_gap_the_estimate_coasts_with_the_last_unknown_inputs_and_then_recovers():
    """A gap of 0.5 s; the estimate is as good in it as before, and after 0.5 s it is so again."""
    observer = joint_observer(PiSchedule(1.0, 1e6, 1.0))
    rows = coupled(observer, joint_plant(), [1e-3] * 3500, lost=lambda k: 2000 <= k < 2500)
    t, error, valid, state_error = rows[:, 0], np.abs(rows[:, 1] - 2.0), rows[:, 3], rows[:, 4]
    assert np.array_equal(np.flatnonzero(valid == 0), np.arange(2000, 2500))
    before = (t > 1.9) & (t <= 2.0)
    for window in (valid == 0, t > 2.5 + 0.5):
        assert np.max(error[window]) < np.max(error[before]) + 0.01
        assert np.max(state_error[window]) < np.max(state_error[before]) + 0.005
    assert len(set(rows[valid == 0, 1])) == 1


def test_bad_samples_from_the_start_leave_the_models_own_motion():
    """Nothing is known of the unknown inputs yet, so x̂' = A x̂ + B u + G₁ f(x̂)."""
    observer = joint_observer(PiSchedule(1.0, 1e6, 1.0))
    own = observer.init(WRONG)
    for _ in range(100):
        own, estimate = observer.step(own, (TORQUE,), (np.nan, np.nan), 0.01)
    plant = joint_plant(0.0)
    exact = plant.step(plant.init(WRONG, 0.0), (TORQUE,), (0.0,), 1.0)
    np.testing.assert_allclose(estimate.x_hat, exact.x, rtol=0, atol=1e-6)
    assert estimate.d_hat[0] == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_bad_input_is_replaced_by_the_last_good_one(bad):
    observer = joint_observer(PiSchedule(1.0, 1e6, 0.0))
    state, _ = observer.step(observer.init(WRONG), (0.8,), (0.3, -0.2), 0.01)
    replaced, estimate = observer.step(state, (bad,), (0.31, -0.2), 0.01)
    _, expected = observer.step(state, (0.8,), (0.31, -0.2), 0.01)
    np.testing.assert_array_equal(estimate.x_hat, expected.x_hat)
    assert estimate.valid
    assert replaced.u[0] == 0.8


# -- (g) other plants: matched and unmatched, several disturbances, more outputs than unknown inputs


@pytest.mark.parametrize("problem", RANDOM, ids=lambda problem: problem.name)
def test_at_rest_under_a_constant_d_the_estimate_comes_to_d_like_pi_to_the_minus_1_over_2r(problem):
    """r is the largest relative degree of the disturbances, or better where the bias of W is of higher order."""
    model = to_model(problem.linear)
    eq, C = compile_model(model), problem.linear.C
    n, m, _, _ = problem.shape
    d, u = np.linspace(1.0, 2.0, len(model.disturbances)), np.linspace(-1.0, 1.0, m)
    x = root(lambda x: eq.derivatives(x, u, d, ()), np.zeros(n), tol=1e-12).x
    assert np.max(np.abs(eq.derivatives(x, u, d, ()))) < 1e-12
    pis, errors = np.array([1e4, 1e6, 1e8]), []
    for pi in pis:
        observer = paper_observer(eq, (), PiSchedule(1.0, pi, 0.0), alpha=0.4)
        state = observer.init(x)
        for _ in range(250):
            state, estimate = observer.step(state, u, C @ x, 0.1)
        errors.append(np.linalg.norm(estimate.d_hat - d))
    assert np.all(np.diff(errors) < 0)
    slope = np.polyfit(np.log(pis), np.log(errors), 1)[0]
    assert slope <= -1.0 / (2 * max(problem.relative_degrees)) + 0.03
    assert errors[-1] < 0.1


# -- (h) a large Lipschitz constant


@pytest.mark.parametrize("pi", [1e2, 4e4])
@pytest.mark.parametrize("H", [0.01, 0.05])
def test_a_friction_too_steep_for_the_step_is_integrated_in_substeps(H, pi):
    """The motor's γ‖G‖ = 200 1/s, so that γ‖G‖H is 2 and 10; against SciPy's stiff solver with the same y and L."""
    motor = MODELS["dc_motor"]
    linear, p = linear_part(motor), motor.parameter_values()
    observer = paper_observer(compile_model(motor), p, PiSchedule(1.0, pi, 0.0), alpha=20.0)
    assert observer.fastest_f == pytest.approx(200.0)
    x_hat, y = np.array([0.0, 3.0, 0.5]), np.array([0.02])
    past = History(ages=np.array([H, 2.0 * H]), samples=np.array([[-3.0 * H], [-5.0 * H]]))
    held = past.with_sample(y, 2)
    L = solve_riccati(linear.A, linear.C, linear.G, pi=pi, alpha=20.0).Q @ linear.C.T

    def derivatives(t, x):
        friction = -0.2 * np.tanh(x[1] / 0.5)
        return linear.A @ x + linear.B @ [5.0] + linear.G_f @ [friction] + L @ (held.at(t) - linear.C @ x)

    fine = solve_ivp(derivatives, (0.0, H), x_hat, method="Radau", rtol=1e-10, atol=1e-12).y[:, -1]
    _, estimate = observer.step(replace(observer.init(x_hat), history=past), (5.0,), y, H)
    np.testing.assert_allclose(estimate.x_hat, fine, rtol=1e-6, atol=1e-7)


# -- refused


def test_gains_that_cannot_be_trusted_are_refused_when_the_observer_is_made():
    problem = RANDOM[3]
    with pytest.raises(DesignError, match="too large a pi"):
        paper_observer(compile_model(to_model(problem.linear)), (), PiSchedule(1.0, 1e36, 0.0), alpha=0.4)


@pytest.mark.parametrize("alpha", [0.0, -1.0, np.nan, np.inf])
def test_an_alpha_that_is_not_a_finite_number_above_zero_is_refused(alpha):
    with pytest.raises(DesignError, match="alpha: expected a finite number > 0"):
        paper_observer(compile_model(JOINT), JOINT.parameter_values(), PiSchedule(1.0, 1e4, 0.0), alpha=alpha)


def test_an_alpha_beyond_the_zeros_is_refused():
    """Theorem 1: α < min(−Re z); here the zeros are −2 and −0.5."""
    equations = compile_model(to_model(RANDOM[0].linear))
    paper_observer(equations, (), PiSchedule(1.0, 1e4, 0.0), alpha=0.49)
    with pytest.raises(AssumptionError):
        paper_observer(equations, (), PiSchedule(1.0, 1e4, 0.0), alpha=0.51)
