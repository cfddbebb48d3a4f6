"""Method 2: how accurate, how soon, how honest about its error, and what it does with bad samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.errors import DesignError
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.step import sampled_step
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import MODELS, RANDOM, to_model

FLEXIBLE = MODELS["flexible_joint"]
SINE = 2.0 * np.pi
STEPS = [1e-3, 5e-3, 1e-2]


def observer_of(model=FLEXIBLE, *, order=2, noise_std=0.0, bound=None, rate=None, x_std=None, pi=1e8, adapt_noise=True):
    eq = compile_model(model)
    bound = eq.disturbance_bound if bound is None else bound
    return sampled_observer(
        eq,
        model.parameter_values(),
        order=order,
        noise_std=[noise_std] * len(model.outputs),
        disturbance_bound=bound,
        disturbance_rate=[b * SINE ** max(order, 1) for b in bound] if rate is None else rate,
        x_hat=eq.xhat0,
        x_std=eq.xhat0_std if x_std is None else x_std,
        alpha=model.observer.alpha,
        pi=pi,
        adapt_noise=adapt_noise,
    )


class Run:
    """Plant and observer side by side; every array has one row per step, errors are d̂ − d of the first disturbance."""

    def __init__(self, observer, generators, H, duration, *, sigma=0.0, seed=0, x0=None, spoil=None, steps=None):
        eq = observer.equations
        random = np.random.default_rng(seed)
        plant = Plant(eq, observer.parameters, generators)
        x = plant.init(eq.x0 if x0 is None else x0, 0.0)
        state = observer.init(eq.xhat0)
        C, q = observer.system.linear.C, len(eq.disturbances)
        u, t, rows = [0.0] * len(eq.inputs), 0.0, []
        for k, h in enumerate([H] * round(duration / H) if steps is None else steps):
            y = C @ x.x + sigma * random.normal(size=len(C))
            if spoil is not None:
                y = spoil(k, y)
            true = np.array(plant.disturbance(t, [0.0] * q))
            state, e = observer.step(state, u, y, h)
            t += h
            x = plant.step(x, u, [0.0] * q, t)
            then = np.array(plant.disturbance(t, [0.0] * q))
            score = np.array(e.residual) / e.residual_std
            rows.append((t, e.d_at_sample - true, e.d_hat - then, e.d_std, e.valid, e.d_hat, score))
        self.time = np.array([row[0] for row in rows])
        self.at_sample, self.ahead, self.std = (np.array([row[i] for row in rows])[:, 0] for i in (1, 2, 3))
        self.all_ahead, self.all_std = np.array([row[2] for row in rows]), np.array([row[3] for row in rows])
        self.valid = np.array([row[4] for row in rows])
        self.d_hat = np.array([row[5] for row in rows])[:, 0]
        self.residual_score = np.array([row[6] for row in rows])
        self.state = state


def constant(value=2.0):
    return [Generator(KINDS["constant"], value)]


def sine(frequency, amplitude=1.0, start=0.0):
    return [Generator(KINDS["sine"], amplitude, frequency, start)]


# -- residuals


@pytest.mark.parametrize(("order", "H", "sigma"), [(0, 1e-2, 1e-3), (1, 5e-3, 1e-4), (2, 1e-2, 1e-3), (3, 5e-3, 1e-4)])
def test_residuals_are_as_large_as_the_observer_expects_them(order, H, sigma):
    """From the first sample on, where the start is wrong by what it is said to be, and later in noise and a sine."""
    observer = observer_of(order=order, noise_std=sigma, bound=[2.0])
    run = Run(observer, sine(1.0, 2.0), H, 400 * H, sigma=sigma, seed=7)
    np.testing.assert_allclose(run.residual_score[0], 1.0, atol=0.01)  # x₀ − x̂₀ is as large as hat_start_std
    late = run.residual_score[60:]
    # For r = 0 the sine shows in the residuals, and is no noise.
    assert np.sqrt(np.mean(late**2)) == pytest.approx(1.0, abs=0.25 if order == 0 else 0.1)
    assert np.mean(np.abs(late) < 2.0) > 0.92
    assert np.mean(np.abs(run.residual_score[:60]) < 3.0) > 0.95


def test_residuals_are_larger_than_expected_where_the_noise_is_larger_than_told():
    run = Run(observer_of(noise_std=1e-4, bound=[2.0], adapt_noise=False), constant(), 5e-3, 2.0, sigma=5e-4, seed=3)
    assert np.sqrt(np.mean(run.residual_score[60:] ** 2)) > 2.5


# -- accuracy


@pytest.mark.parametrize("H", STEPS)
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_a_constant_disturbance_is_found_within_ten_samples_without_a_schedule_and_then_exactly(H, order):
    run = Run(observer_of(order=order), constant(), H, 2.5)
    outside = np.flatnonzero(np.abs(run.at_sample) > 0.02 * 2.0)
    assert outside[-1] + 2 <= 10
    assert np.abs(run.d_hat).max() <= 3.0 * 5.0
    late = run.time > 2.0
    assert np.abs(run.at_sample[late]).max() <= 1e-7
    assert np.abs(run.ahead[late]).max() <= 1e-7
    assert run.valid.all()


@pytest.mark.parametrize("H", STEPS)
@pytest.mark.parametrize("order", [2, 3])
def test_a_ramp_is_followed_exactly(H, order):
    run = Run(observer_of(order=order), [Generator(KINDS["ramp"], 1.0)], H, 2.5)
    late = run.time > 2.0
    assert np.abs(run.at_sample[late]).max() <= 1e-7
    assert np.abs(run.ahead[late]).max() <= 1e-7


@pytest.mark.parametrize(
    ("H", "frequency", "largest"),
    [
        (1e-3, 1.0, 2e-7),
        (5e-3, 1.0, 2e-5),
        (1e-2, 1.0, 2e-4),
        (1e-3, 5.0, 2e-5),
        (5e-3, 5.0, 2e-3),
        (1e-2, 5.0, 1.5e-2),
    ],
)
def test_a_sine_is_followed_as_closely_as_its_bound_allows(H, frequency, largest):
    rate = (SINE * frequency) ** 3
    run = Run(observer_of(order=3, rate=[rate]), sine(frequency), H, 2.5)
    late = run.time > 1.5
    assert np.abs(run.at_sample[late]).max() <= largest
    assert np.abs(run.ahead[late]).max() <= 3.3 * H**3 * rate


@pytest.mark.parametrize("seed", range(8))
def test_random_sines_of_the_class_stay_within_what_the_design_predicts(seed):
    random = np.random.default_rng(seed)
    H, order = float(random.choice(STEPS)), int(random.integers(1, 4))
    frequency, start = random.uniform(0.2, 4.0), random.uniform(0.0, 0.5)
    amplitude = random.uniform(0.2, 4.0)
    rate = amplitude * (SINE * frequency) ** order
    observer = observer_of(order=order, rate=[rate])
    run = Run(observer, sine(frequency, amplitude, start), H, 2.5)
    late = run.time > 1.5
    predicted = observer.design(H).bias_gain()[0, 0] * rate
    assert np.abs(run.at_sample[late]).max() <= 1.3 * predicted + 1e-7


@pytest.mark.parametrize("index", [0, 1, 3, 5, 7])
@pytest.mark.parametrize("sigma", [0.0, 1e-9, 1e-6])
def test_a_state_that_only_slow_zeros_forget_does_not_spoil_the_start(index, sigma):
    """f is wrong as long as that state is, for thousands of steps; to trust it sooner makes |d̂| 10² to 10⁹.

    Of states that are measured in sums only, without noise, the covariance has few digits: |d̂| went beyond 10³⁰.
    """
    model = to_model(RANDOM[index].linear)
    x0 = 0.3 * np.random.default_rng(1).normal(size=len(model.states))
    disturbances = sine(1.0, 2.0) * len(model.disturbances)
    for H, order in ((1e-3, 2), (1e-2, 3)):
        observer = observer_of(model, order=order, noise_std=sigma)
        run = Run(observer, disturbances, H, 150 * H, sigma=sigma, x0=x0)
        assert np.abs(run.d_hat).max() <= 3.0 * 2.0


# -- examples


@pytest.mark.parametrize("name", ["dc_motor", "three_tank", "car_in_crosswind"])
@pytest.mark.parametrize("H", [1e-3, 1e-2])
def test_the_examples_disturbances_are_found_to_a_percent_of_their_bound(name, H):
    model = MODELS[name]
    observer = observer_of(model, order=2)
    bounds = compile_model(model).disturbance_bound
    generators = [Generator(KINDS["sine"], 0.5 * bound, 0.5) for bound in bounds]
    run = Run(observer, generators, H, 3.0)
    late = run.time > 2.0
    assert np.all(np.abs(run.all_ahead[late]).max(axis=0) <= 0.01 * np.array(bounds))


# -- the error bar


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("sigma", [1e-4, 1e-5])
@pytest.mark.parametrize("H", [4e-3, 1e-2])
def test_the_error_lies_within_two_error_bars_in_90_to_99_percent_of_the_samples(order, sigma, H):
    inside = []
    for seed in range(3):
        random = np.random.default_rng(100 + seed)
        frequency = random.uniform(0.8, 1.2)
        rate = 2.0 * (SINE * frequency) ** order
        observer = observer_of(order=order, noise_std=sigma, rate=[rate])
        run = Run(observer, sine(frequency, 2.0, random.uniform(0.0, 0.3)), H, 3.0, sigma=sigma, seed=seed)
        late = run.time > 1.0
        inside.append(np.abs(run.ahead[late]) <= 2.0 * run.std[late])
    assert 0.90 <= np.mean(np.concatenate(inside)) <= 0.99


def test_the_error_bar_is_honest_from_the_first_sample_on():
    observer = observer_of(order=2, noise_std=1e-4, x_std=[0.3, 0.5, 0.3, 0.5])
    inside = []
    for seed in range(20):
        random = np.random.default_rng(seed)
        x0 = np.array(compile_model(FLEXIBLE).xhat0) + random.normal(size=4) * [0.3, 0.5, 0.3, 0.5]
        amplitude = 5.0 * random.uniform(-1.0, 1.0)
        run = Run(observer, sine(1.0, amplitude), 5e-3, 0.25, sigma=1e-4, seed=seed, x0=x0)
        inside.append(np.abs(run.ahead) <= 3.0 * run.std)
    assert np.mean(inside) > 0.95


# -- the step


def test_the_gain_is_frozen_once_it_has_converged():
    observer = observer_of(noise_std=1e-5)
    run = Run(observer, constant(), 5e-3, 2.0, sigma=1e-5)
    assert run.state.memory.converged
    np.testing.assert_array_equal(run.state.memory.columns.factor, observer.design(5e-3).prior_factor)


@pytest.mark.parametrize("sigma", [0.0, 2e-5, 5e-4])
def test_the_gain_is_frozen_for_the_noise_that_was_found_where_another_was_told(sigma):
    observer = observer_of(noise_std=1e-4, bound=[2.0])
    run = Run(observer, sine(1.0, 1.0), 2e-3, 6.0, sigma=sigma, seed=1)
    memory = run.state.memory
    assert memory.converged
    told = (1e-4 / sigma) ** 2 if sigma else 1e4
    assert all(0.5 < told * ratio < 4.0 for ratio in memory.frozen_noise)
    late = run.time > 4.0
    assert np.mean(np.abs(run.ahead[late]) < 2.0 * run.std[late]) > 0.9


@pytest.mark.parametrize("told", [0.4, 2.5])
def test_the_gain_is_not_frozen_before_the_samples_have_shown_the_noise(told):
    """Right after the start nothing speaks against the noise that was told."""
    run = Run(observer_of(order=1, noise_std=told * 1e-4, bound=[2.0]), constant(), 2e-3, 2.0, sigma=1e-4, seed=2)
    assert run.state.memory.converged
    assert all(0.5 < told**2 * ratio < 2.0 for ratio in run.state.memory.frozen_noise)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("H", [1e-3, 5e-3])
def test_a_gain_for_a_step_that_is_off_by_a_fifth_loses_less_than_a_hundredth(order, H):
    """So a frozen gain serves steps that jitter; exact, by the covariance of the error with either gain."""
    observer = observer_of(order=order, noise_std=1e-4)
    frozen = observer.designs.at(H, H).stationary.K

    def variance(design, K):
        units, Phi = np.sqrt(np.diag(design.prior_factor @ design.prior_factor.T)), design.discrete.Phi
        closed = Phi @ (np.eye(len(Phi)) - K @ design.system.C)
        each = np.hstack([design.noise_factor, Phi @ K @ design.sample_factor]) / units[:, None]
        P = solve_discrete_lyapunov(closed * units / units[:, None], each @ each.T)
        seen = design.system.selector * units
        return float((seen @ P @ seen.T)[0, 0])

    for part in (0.8, 1.2):
        design = observer.designs.at(part * H, H).stationary
        own = variance(design, design.K)
        assert own <= variance(design, frozen) < 1.01**2 * own


def jittered(seed, part, count, H=2e-3):
    """Return steps between samples whose times jitter by a part of H."""
    times = H * (np.arange(count + 1) + part * np.random.default_rng(seed).normal(size=count + 1))
    return np.maximum(np.diff(times), 0.1 * H)


def test_the_gain_stays_frozen_where_the_times_of_samples_jitter(monkeypatch):
    """It costs less than 1 % of the estimate, because a gain for a step off by a few per cent is nearly the best."""
    steps = jittered(5, 0.05, 3000)

    def run_of():
        return Run(observer_of(order=1, noise_std=1e-4), sine(1.0), None, None, sigma=1e-4, seed=4, steps=steps)

    calls, whole = [], sampled_step.step_with_covariance

    def counted(*arguments):
        calls.append(1)
        return whole(*arguments)

    monkeypatch.setattr(sampled_step, "step_with_covariance", counted)
    frozen = run_of()
    assert len(calls) < 0.1 * len(steps)
    monkeypatch.setattr(sampled_step, "frozen", lambda tuned, design_at, after, *_: after)
    running = run_of()
    assert len(calls) > len(steps)
    late = running.time > 1.0
    error, least = (float(np.sqrt(np.mean(run.at_sample[late] ** 2))) for run in (frozen, running))
    assert error <= 1.01 * least
    assert np.mean(np.abs(frozen.ahead[late]) < 2.0 * frozen.std[late]) > 0.9


def test_steps_that_differ_by_rounding_keep_the_gain_frozen():
    times = 0.1 + 1e-3 * np.arange(400)
    assert len(set(np.diff(times))) > 2
    run = Run(observer_of(noise_std=1e-4), constant(), None, None, sigma=1e-4, steps=np.diff(times))
    assert run.state.memory.converged


def test_a_gain_is_frozen_again_soon_after_a_lost_sample():
    def gap(k, y):
        return np.array([np.nan, np.nan]) if k == 500 else y

    run = Run(observer_of(order=1, noise_std=1e-4), constant(), 2e-3, 1.02, sigma=1e-4, seed=1, spoil=gap)
    assert run.state.memory.converged


def test_the_gain_of_sensors_with_different_rates_is_not_frozen():
    """The covariance rises and falls between the samples of the slow one; a frozen gain holds for none of them."""

    def slow(k, y):
        return np.array([y[0], y[1] if k % 10 == 0 else np.nan])

    run = Run(observer_of(noise_std=1e-4), constant(), 5e-3, 1.5, sigma=1e-4, spoil=slow)
    assert not run.state.memory.converged
    stepped = Run(observer_of(noise_std=1e-4), constant(), 5e-3, 1.505, sigma=1e-4, spoil=slow)
    assert not stepped.state.memory.converged  # right after a sample of both


def test_the_samples_that_end_a_frozen_gain_do_not_make_the_noise_larger():
    """They are there because they are far from their prediction; taken for fair ones they double the variance."""
    run = Run(observer_of(noise_std=1e-4, bound=[2.0]), sine(1.0, 1.0), 1e-3, 4.0, sigma=1e-4, seed=1)
    assert run.state.memory.converged
    assert all(0.75 < sensor.noise_ratio < 1.3 for sensor in run.state.memory.sensors)


def test_the_host_may_change_its_step_in_every_way():
    steps = [1e-3] * 300 + [2e-3] * 200 + [1e-3 * (1 + 1e-12)] * 200 + [1e-2] * 60
    run = Run(observer_of(), constant(), None, None, steps=steps)
    settled = np.ones(len(steps), dtype=bool)
    for change in (0, 300, 500, 700):
        settled[change : change + 20] = False
    assert np.abs(run.ahead[settled]).max() <= 1e-6
    random = np.random.default_rng(3)
    jittered = Run(observer_of(), constant(), None, None, steps=5e-3 * random.uniform(0.95, 1.05, 150))
    assert np.abs(jittered.ahead[30:]).max() <= 1e-6


def test_a_step_depends_on_nothing_but_its_arguments():
    observer = observer_of(noise_std=1e-5)
    eq = compile_model(FLEXIBLE)
    start = observer.init(eq.xhat0)
    first, one = observer.step(start, [0.1], [1.0, 0.9], 2e-3)
    for H in (1e-3, 2e-3, 5e-3):
        observer.step(first, [0.3], [0.2, 0.1], H)
    again, two = observer.step(start, [0.1], [1.0, 0.9], 2e-3)
    np.testing.assert_array_equal(first.xi_hat, again.xi_hat)
    np.testing.assert_array_equal(first.memory.columns.factor, again.memory.columns.factor)
    np.testing.assert_array_equal([one.d_hat, one.d_std], [two.d_hat, two.d_std])
    np.testing.assert_array_equal(start.xi_hat[:4], eq.xhat0)


# -- bad samples

NOISE = 1e-5
H_BAD, BAD_FROM, BAD_TO = 5e-3, 300, 312


def spoiled(how, order=2):
    """Run with a disturbance that moves, and with some samples of both outputs replaced by how(k, y, last good)."""
    last = {}

    def spoil(k, y):
        if not BAD_FROM <= k < BAD_TO:
            last["y"] = y
            return y
        return how(k, y, last["y"])

    observer = observer_of(order=order, noise_std=NOISE)
    return Run(observer, sine(1.0, 2.0), H_BAD, 2.5, sigma=NOISE, spoil=spoil)


@pytest.mark.parametrize(
    "how",
    [
        lambda k, y, last: y * np.nan,
        lambda k, y, last: np.array([np.inf, -np.inf]),
        lambda k, y, last: y + 0.3 * (-1.0) ** k,
    ],
    ids=["nan", "inf", "flickering sensors"],
)
def test_bad_samples_are_flagged_coasted_over_and_recovered_from(how):
    run = spoiled(how)
    bad = slice(BAD_FROM, min(BAD_TO, BAD_FROM + 10))
    assert not run.valid[bad].any()
    assert run.valid[:BAD_FROM].all()
    assert run.valid[BAD_TO + 2 :].all()
    # Coasting on the last derivatives of d, for 50 ms of a sine of 1 Hz; then back to what it was.
    assert np.abs(run.ahead[bad]).max() <= 1.0
    before = np.abs(run.ahead[200:BAD_FROM]).max()
    assert np.abs(run.ahead[BAD_TO + 60 :]).max() <= 2.0 * before


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1.0])
def test_while_one_sensor_fails_the_other_one_keeps_the_estimate_valid(bad):
    run = spoiled(lambda k, y, last: np.array([y[0], y[1] + bad]))
    assert run.valid.all()
    before = np.abs(run.ahead[200:BAD_FROM]).max()
    assert np.abs(run.ahead[BAD_FROM:]).max() <= 4.0 * before


def test_a_sensor_that_sticks_while_the_plant_moves_is_noticed_and_forgotten():
    run = spoiled(lambda k, y, last: last)
    moving = run.valid[BAD_FROM:BAD_TO]
    assert not moving[1:10].any()
    assert np.all(np.isfinite(run.d_hat))
    assert run.valid[BAD_TO + 60 :].all()
    assert np.abs(run.ahead[BAD_TO + 60 :]).max() <= 3.0 * np.abs(run.ahead[200:BAD_FROM]).max()


def test_after_ten_refusals_it_is_the_estimate_that_starts_anew():
    """A plant that was moved by hand: the samples are right, the estimate is wrong."""
    run = spoiled(lambda k, y, last: y * np.nan)
    assert run.valid[BAD_TO:].mean() > 0.99
    observer = observer_of(noise_std=NOISE)
    eq, C = compile_model(FLEXIBLE), linear_part(FLEXIBLE).C
    plant = Plant(eq, observer.parameters, constant())
    x, state, errors, valid = plant.init(eq.x0, 0.0), observer.init(eq.xhat0), [], []
    for k in range(400):
        if k == 250:
            x = plant.init(x.x + np.array([0.5, 0.0, 0.5, 0.0]), x.t)
        state, e = observer.step(state, [0.0], C @ x.x, H_BAD)
        x = plant.step(x, [0.0], [0.0], (k + 1) * H_BAD)
        errors.append(abs(e.d_hat[0] - 2.0))
        valid.append(e.valid)
    assert not any(valid[250:260])
    assert all(valid[262:])
    assert max(errors[320:]) <= 0.02


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize(("noise_std", "H"), [(1e-7, 1e-3), (1e-6, 1e-3), (1e-5, 1e-3), (1e-6, 5e-3), (1e-5, 5e-3)])
def test_no_sample_after_a_jump_of_the_disturbance_is_taken_for_a_bad_one(order, noise_std, H):
    """What a jump within the bound leads to grows from sample to sample until the observer catches up."""
    observer = observer_of(order=order, noise_std=noise_std, bound=[5.0], rate=[SINE**order])
    for amplitude, at in ((2.0, 0.4 + 0.3 * H), (10.0, 0.4 + 0.5 * H)):
        run = Run(observer, [Generator(KINDS["step"], amplitude, 0.0, at)], H, 0.6, sigma=noise_std)
        assert run.valid.all()


def test_an_input_that_is_not_finite_is_replaced_by_the_last_one():
    observer = observer_of()
    state = observer.init(compile_model(FLEXIBLE).xhat0)
    state, _ = observer.step(state, [0.5], [1.0, 1.0], 1e-3)
    same, one = observer.step(state, [0.5], [1.0, 1.0], 1e-3)
    lost, two = observer.step(state, [np.nan], [1.0, 1.0], 1e-3)
    np.testing.assert_array_equal(one.x_hat, two.x_hat)
    np.testing.assert_array_equal(same.u, lost.u)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"order": 4}, "disturbance_order: expected 0, 1, 2 or 3, received 4"),
        ({"noise_std": -1.0}, "noise_std: expected finite numbers ≥ 0"),
        ({"noise_std": np.nan}, "noise_std"),
        ({"bound": [0.0]}, "disturbance_bound: expected finite numbers > 0"),
        ({"rate": [-1.0]}, "disturbance_rate: expected finite numbers ≥ 0"),
        ({"x_std": [1.0, 1.0, 0.0, 1.0]}, "hat_start_std: expected finite numbers > 0"),
        ({"pi": 0.0}, "pi_end: expected a finite number > 0"),
    ],
)
def test_what_means_nothing_is_refused_in_one_line(wrong, says):
    with pytest.raises(DesignError, match=says) as caught:
        observer_of(**wrong)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_only_suspected_of_a_jump_does_not_carry_the_estimate_beyond_its_bound(seed):
    """The true disturbance is never there, so that a value at the bound is nearer to it."""
    integrator = compile_model(
        Model(
            name="Integrator",
            states=["x"],
            inputs=["u"],
            outputs=["y"],
            disturbances=["d"],
            parameters={},
            **{"A": [[0.0]], "B": [[1.0]], "C": [[1.0]], "G_d": [[1.0]]},
        )
    )
    told = {"order": 1, "noise_std": (0.02,), "disturbance_bound": (2.0,), "disturbance_rate": (1.0,)}
    # With a lag the covariance runs all the time, and with it the hypotheses of a jump.
    observer = sampled_observer(integrator, (), x_hat=(0.0,), lag=0.05, **told)
    random, state, x, d, shifted = np.random.default_rng(seed), observer.init((0.0,)), 0.0, 1.8, 0
    for k in range(300):
        d = -d if k % 100 == 99 else d
        state, estimate = observer.step(state, (0.0,), (x + 0.02 * random.standard_normal(),), 0.01)
        x += 0.01 * d
        without_jump = state.xi_hat[1]
        shifted += abs(estimate.d_hat[0] - without_jump) > 0.1
        assert abs(estimate.d_hat[0]) <= max(2.0, abs(without_jump)) + 1e-12
    assert shifted > 0
