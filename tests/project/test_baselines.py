"""The baselines of the accuracy benchmark are correct, so that the comparison is fair."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from math import factorial
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

from benchmarks.accuracy_cells import D0, QUICK, SIGNALS, Plan, Record, Score, Signal, magnitude, score, setting
from benchmarks.accuracy_must_show import Row, as_text, least_error
from benchmarks.accuracy_page import compare
from benchmarks.baselines import extended_kalman_filter, extended_state_observer, linear_system, second_difference
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.runtime.design.tuning import tuned_intensities
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import system_with_zeros, to_model

ROOT = Path(__file__).parents[2]
STIFFNESS, DAMPING = 1.5, 0.7


def linear_plant(**kind):
    """Return a linear part without f."""
    linear = system_with_zeros(inputs=3, seed=3, **kind).linear
    return replace(linear, G_f=np.zeros((len(linear.A), 0)), matched=False)


def sampled_noise(A, G, H):
    """Return ∫₀ᴴ e^{At} G Gᵀ e^{Aᵀt} dt by quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(30)
    halves = [expm(A * 0.5 * H * (1.0 + node)) @ G for node in nodes]
    return sum(0.5 * H * weight * half @ half.T for half, weight in zip(halves, weights, strict=True))


@pytest.mark.parametrize(
    "kind",
    [{"relative_degrees": (2,), "zeros": (-1.5, -0.4), "extra_outputs": 1}, {"relative_degrees": (3, 2)}],
    ids=["n4 p2 q1", "n5 p2 q2"],
)
def test_the_kalman_filter_without_disturbances_has_the_gain_of_the_riccati_equation(kind):
    linear, H, steps = linear_plant(**kind), 0.05, 600
    n, q, p = len(linear.A), linear.G_d.shape[1], len(linear.C)
    intensity, sigma = np.array([0.7, 2.3])[:q], np.array([0.1, 0.3])[:p]
    random = np.random.default_rng(1)
    estimates = extended_kalman_filter(
        linear_system(linear.A, linear.C, linear.G_d),
        0,
        H,
        random.normal(size=(2, steps, p)),
        noise_std=np.tile(sigma, (2, 1)),
        intensity=np.tile(intensity, (2, 1)),
        x_hat=np.zeros(n),
        prior_std=np.ones(n),
        read=np.eye(n),
    )
    Q, R = sampled_noise(linear.A, linear.G_d * np.sqrt(intensity), H), np.diag(sigma**2)
    P = solve_discrete_are(expm(linear.A * H).T, linear.C.T, Q, R)
    expected = P @ linear.C.T @ np.linalg.inv(linear.C @ P @ linear.C.T + R)
    for K in estimates.K:
        np.testing.assert_allclose(K, expected, rtol=1e-7, atol=1e-8 * np.max(np.abs(expected)))
    Phi = expm(linear.A * H)
    np.testing.assert_allclose(estimates.ahead, estimates.at_sample @ Phi.T, rtol=0, atol=1e-8)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_on_a_linear_plant_the_kalman_filter_is_this_packages_observer(order):
    """Two implementations that share no code: square roots by quadrature there, by Van Loan's formula here."""
    linear = linear_plant(relative_degrees=(2,), zeros=(-1.5,), extra_outputs=1)
    H, sigma, steps, rate = 0.01, 1e-3, 300, (2.0 * np.pi) ** order
    n, p = len(linear.A), len(linear.C)
    equations = compile_model(to_model(linear))
    observer = sampled_observer(
        equations,
        list(equations.parameters.values()),
        order=order,
        noise_std=[sigma] * p,
        disturbance_bound=[D0],
        disturbance_rate=[rate],
        x_hat=[0.0] * n,
        x_std=[1.0] * n,
        alpha=1.0,
        pi=1e12,
        adapt_noise=False,
    )
    solution = solve_ivp(
        lambda t, x: linear.A @ x + linear.G_d[:, 0] * np.sin(2.0 * np.pi * t),
        (0.0, steps * H),
        np.full(n, 0.5),
        t_eval=np.arange(steps) * H,
        rtol=1e-9,
        atol=1e-11,
    )
    samples = solution.y.T @ linear.C.T + sigma * np.random.default_rng(2).normal(size=(steps, p))
    tuned = tuned_intensities(observer.system, H, 1.0, observer.known)
    kalman = extended_kalman_filter(
        linear_system(linear.A, linear.C, linear.G_d),
        order,
        H,
        samples[None],
        noise_std=np.full((1, p), sigma * tuned.scale),
        intensity=tuned.disturbance[None] * tuned.scale**2,
        x_hat=np.zeros(n),
        prior_std=np.concatenate([np.ones(n), D0 * (rate / D0) ** (np.arange(order) / order)]),
    )
    state, ours, frozen = observer.init([0.0] * n), [], []
    for y in samples:
        frozen.append(state.memory.converged)
        state, estimate = observer.step(state, [0.0] * linear.B.shape[1], y, H)
        ours.append((estimate.d_at_sample[0], estimate.d_hat[0]))
    expected = np.column_stack([kalman.at_sample[0, :, 0], kalman.ahead[0, :, 0]])
    assert np.max(np.abs(expected[100:, 0] - np.sin(2.0 * np.pi * H * np.arange(100, steps)))) < 0.8
    begins = frozen.index(True) if any(frozen) else steps
    np.testing.assert_allclose(ours[:begins], expected[:begins], rtol=0, atol=1e-5)
    # The gain is frozen within 2 % of the converged standard deviation.
    assert np.max(np.abs(np.array(ours) - expected)[begins:], initial=0.0) < 0.02 * estimate.d_std[0]


def test_the_extended_kalman_filter_finds_a_constant_behind_a_nonlinearity():
    """The flexible joint: f = −10 sin θ moves it by far more than the disturbance does."""
    case, H, steps = setting(), 5e-3, 400
    system = case.system

    def derivatives(t, x):
        return system.A @ x + system.G_f @ system.f(x[None])[0] + system.G_d[:, 0] * 2.0

    time = np.arange(steps) * H
    x = solve_ivp(derivatives, (0.0, time[-1]), [1.0] * 4, method="DOP853", t_eval=time, rtol=1e-13, atol=1e-14).y.T
    estimates = extended_kalman_filter(
        system,
        2,
        H,
        (x @ system.C.T)[None],
        noise_std=np.full((1, 2), 1e-12),
        intensity=np.ones((1, 1)),
        x_hat=case.x_hat,
        prior_std=np.array([2.0, 2.0, 2.0, 2.0, 5.0, 30.0]),
    )
    assert np.max(np.abs(estimates.at_sample[0, 100:, 0] - 2.0)) < 1e-6
    assert np.max(np.abs(estimates.ahead[0, 100:, 0] - 2.0)) < 1e-6


def test_the_jacobian_of_the_benchmarks_plant_is_that_of_its_f():
    system, step = setting().system, 1e-6
    x = np.random.default_rng(0).normal(size=(5, 4))
    for i, direction in enumerate(step * np.eye(4)):
        difference = (system.f(x + direction) - system.f(x - direction)) / (2.0 * step)
        np.testing.assert_allclose(system.jacobian(x)[:, :, i], difference, rtol=0, atol=1e-8)


def motor_samples(H, steps, d_coefficients):
    """Return exact samples [φ, θ] (1,K,2) and d (K,), θ running straight between samples and d a polynomial in t."""
    order = len(d_coefficients)
    random = np.random.default_rng(4)
    link = np.cumsum(random.normal(size=steps)) * H
    N = 2 + order
    A = np.zeros((N + 2, N + 2))
    A[0, 1] = 1.0
    A[1, :2] = -STIFFNESS, -DAMPING
    A[1, 2] = 1.0
    A[2 : N - 1, 3:N] = np.eye(order - 1)
    A[1, N] = STIFFNESS
    A[N, N + 1] = 1.0
    Phi = expm(A * H)
    derivatives = [c * factorial(i) for i, c in enumerate(d_coefficients)]
    z = np.concatenate([[0.3, -0.2], derivatives, [0.0, 0.0]])
    rows = []
    for k in range(steps):
        rows.append((z[0], link[k], z[2]))
        z[N] = link[k]
        z[N + 1] = (link[k + 1] - link[k]) / H if k + 1 < steps else 0.0
        z = Phi @ z
    table = np.array(rows)
    return table[None, :, :2], table[:, 2]


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_extended_state_observer_is_exact_for_the_polynomials_that_it_integrates(order):
    H, steps = 0.01, 400
    samples, d = motor_samples(H, steps, [1.7, -0.8, 0.5][:order])
    bandwidth = np.array([15.0, 40.0])
    estimates = extended_state_observer(
        order,
        H,
        np.tile(samples, (2, 1, 1)),
        bandwidth=bandwidth,
        stiffness=STIFFNESS,
        damping=DAMPING,
        start=(0.0, 0.0),
    )
    for found in estimates.at_sample[:, 350:, 0]:
        np.testing.assert_allclose(found, d[350:], rtol=0, atol=1e-8)
    for found in estimates.ahead[:, 350:-1, 0]:
        np.testing.assert_allclose(found, d[351:], rtol=0, atol=1e-8)
    assert np.max(np.abs(estimates.at_sample[0, :20, 0] - d[:20])) > 0.1  # it does start from something wrong


def test_all_poles_of_the_extended_state_observer_lie_at_its_bandwidth():
    H, bandwidth = 0.01, 30.0
    K = extended_state_observer(
        1,
        H,
        np.zeros((1, 1, 2)),
        bandwidth=np.array([bandwidth]),
        stiffness=STIFFNESS,
        damping=DAMPING,
        start=(0.0, 0.0),
    ).K[0]
    Phi = expm(np.array([[0.0, 1.0, 0.0], [-STIFFNESS, -DAMPING, 1.0], [0.0, 0.0, 0.0]]) * H)
    polynomial = np.poly((np.eye(3) - K @ np.eye(3)[:1]) @ Phi)
    np.testing.assert_allclose(polynomial, np.poly([np.exp(-bandwidth * H)] * 3), rtol=0, atol=1e-9)


def test_the_second_difference_is_exact_one_sample_ago_where_the_angle_is_quadratic():
    H, time = 0.02, 0.02 * np.arange(50)
    motor, rate, acceleration = 0.3 - 0.5 * time + 2.0 * time**2, -0.5 + 4.0 * time, 4.0
    link = np.sin(3.0 * time)
    d = acceleration - STIFFNESS * (link - motor) + DAMPING * rate
    estimates = second_difference(H, np.stack([motor, link], axis=1)[None], stiffness=STIFFNESS, damping=DAMPING)
    np.testing.assert_allclose(estimates.at_sample[0, 2:, 0], d[1:-1], rtol=0, atol=1e-10)
    assert np.all(estimates.at_sample[0, :2] == 0.0)
    np.testing.assert_array_equal(estimates.ahead, estimates.at_sample)


# -- the scores


def record_of(signal, H=0.01, stop_time=4.0):
    count = round(stop_time / H)
    d = np.where(H * np.arange(count + 1) >= signal.start, signal.amplitude, 0.0)
    return Record(H, signal, np.zeros((count, 2)), d, {})


def test_without_noise_the_error_is_the_largest_of_the_steady_part():
    data = record_of(SIGNALS[0])
    at_sample, ahead = np.full((2, 1, 400), 2.0)
    at_sample[0, :7], at_sample[0, 250], ahead[0, 300] = -9.0, 2.01, 1.97
    found = score(data, 0.0, at_sample, ahead)
    assert found.error == pytest.approx(0.01)
    assert found.ahead == pytest.approx(0.03)
    assert (found.samples_to_2_percent, found.peak) == (8, 9.0)


def test_a_step_is_judged_from_two_tenths_of_a_second_after_it():
    data = record_of(SIGNALS[2])
    at_sample = np.where(np.arange(400) < 105, 0.0, 2.0)[None]
    at_sample[0, 121] = 2.02
    found = score(data, 0.0, at_sample, np.full((1, 400), 2.0))
    assert found.error == pytest.approx(0.02)
    assert found.steps_after_step == 5


def test_an_estimate_that_ends_outside_2_percent_has_not_settled():
    at_sample = np.full((1, 400), 2.0)
    at_sample[0, -1] = 2.05
    assert score(record_of(SIGNALS[0]), 0.0, at_sample, at_sample).samples_to_2_percent is None


def test_with_noise_the_error_is_bias_amplitude_plus_standard_deviation():
    random = np.random.default_rng(5)
    t = 1e-3 * np.arange(20000)
    noise = 0.2 * random.normal(size=(4, len(t)))
    sine = Signal("sine 1 Hz", "sine", 1.0, 1.0)
    assert magnitude(t, 0.3 * np.sin(2.0 * np.pi * t + 0.4) + noise, sine, 1e-4) == pytest.approx(0.5, abs=0.01)
    assert magnitude(t, -0.3 + noise, SIGNALS[0], 1e-4) == pytest.approx(0.5, abs=0.01)
    chirp = Signal("chirp", "chirp", 1.0, 5.0)
    assert magnitude(t, -0.3 + noise, chirp, 1e-4) == pytest.approx(np.hypot(0.3, 0.2), abs=0.01)


def test_the_noise_depends_on_the_seed_only():
    data, plan = record_of(SIGNALS[3]), Plan()
    assert data.noisy(1e-4, plan).shape == (4, 400, 2)
    np.testing.assert_array_equal(data.noisy(1e-4, plan), data.noisy(1e-4, plan))
    assert not np.any(data.noisy(1e-4, plan) == data.noisy(1e-4, replace(plan, seed=2)))
    assert np.std(data.noisy(1e-4, plan)) == pytest.approx(1e-4, rel=0.05)


@pytest.mark.parametrize(
    ("ours", "told", "scan", "each", "reason"),
    [
        (0.9, 1.0, 0.95, (0.9, 0.9), ""),
        (1e-9, 4e-8, 4e-8, (), "rounding"),
        (1.005, 1.0, 1.0, (1.0, 1.0), ""),
        (4e-8, 1e-8, 1e-9, (), "rounding"),
        (1.0, 1.0, 0.5, (1.0, 1.0), "signal"),
        (1.05, 1.0, 1.0, (0.9, 1.2), "scatter"),
        (1.2, 1.0, 1.0, (1.19, 1.21), "unexplained"),
    ],
)
def test_the_reason_for_another_error_comes_from_the_numbers(ours, told, scan, each, reason):
    signal, H = SIGNALS[3], 0.01
    scores = {
        (H, signal.name, 1e-4, "ours r=2"): Score(ours, ours, each),
        (H, signal.name, 1e-4, "EKF r=2"): Score(told, told, (1.0,) * len(each)),
        (H, signal.name, 1e-4, "EKF r=2, scan"): Score(scan, scan, (1.0,) * len(each)),
    }
    assert compare(Plan(), scores, H, signal, 1e-4, 2, ", scan") == (pytest.approx(ours / scan), reason)


def test_a_missed_requirement_is_shown_as_short():
    table = as_text([Row("a", 1e-3, 1.0, 2.0), Row("b", 1e-3, 2.0, 1.0), Row("c", 1e-2, None, 1.0)])
    assert [line.rsplit("|", 2)[1].strip() for line in table.splitlines()[2:]] == ["**short**", "ok", "reported"]


@pytest.mark.parametrize(("sigma", "order", "found"), [(1e-4, 2, 0.130), (1e-6, 3, 0.0075)])
def test_the_least_error_over_all_intensities_is_the_one_known(sigma, order, found):
    assert least_error(1e-3, sigma, order) == pytest.approx(found, rel=0.02)


def test_the_quick_benchmark_writes_page_and_plot(tmp_path):
    command = [sys.executable, "-m", "benchmarks.accuracy", "--quick", "--workers", "1", "--out", str(tmp_path)]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    figures = ["accuracy.png", "accuracy_faults.png", "accuracy_plants.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["accuracy.md", *figures]
    page = (tmp_path / "accuracy.md").read_text("utf-8")
    assert page.startswith("# How accurate is the estimate")
    assert "short" not in page.split("## Required and measured")[1].split("##")[0]
    for signal in QUICK.signals:
        assert page.count(f"| {signal.name} |") >= 5
    for name in figures:
        assert f"]({name})" in page
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["accuracy.png"])
def test_the_committed_page_has_its_figure(name):
    assert f"]({name})" in (ROOT / "docs" / "accuracy.md").read_text("utf-8")
    assert (ROOT / "docs" / name).stat().st_size < 100_000
